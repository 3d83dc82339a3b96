#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "rosplat_core/map/edit_queue.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/depth_order.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/order/splat_rows.hpp"
#include "rosplat_core/views/sort_view.hpp"

namespace rosplat {

// The viewer's own sorter: a worker thread with a copy of the map's positions, so that no frame
// waits for a sort.
class BuiltInSorter {
 public:
  // Calls apply() with edits that build the current map.
  using Feed = std::function<void()>;

  // The pool makes the orders, and must outlive the sorter. With a feed, the sorter ignores edits
  // until the first order is asked for; then it calls the feed, and takes edits from there on.
  explicit BuiltInSorter(OrderPool& pool, Feed feed = nullptr);
  ~BuiltInSorter();

  // Passes an edit to the worker, which applies edits in order, before sorts asked for later.
  void apply(EditQueue::Node edit) noexcept;
  // Frees the map. With a feed, ignores edits until an order is asked for again.
  void rest();

  // Asks for a sort; replaces a request of the same view that still waits. With `base`, a sidecar's
  // order of an older revision, only the slots changed since are sorted and merged into it.
  void request(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera,
               OrderPtr base = nullptr);

  // Returns the newest finished order of a view, each only once; else null.
  OrderPtr take(const std::string& view_id);

  // Sorts for a camera, and waits for the order.
  OrderPtr sortNow(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera);

  void forget(const std::string& view_id);
  // Size of the copy of the map. 0 if that found no memory: orders are empty then, and say so.
  std::size_t bytes() const;

 private:
  struct Request {
    SplatCamera camera;
    OrderPtr base;
    std::shared_ptr<Order> order;  // to be filled; `source` tells of lacking memory until then
  };
  void begin();
  std::unique_lock<std::mutex> ask(const std::string& view_id, std::uint64_t sequence,
                                   const SplatCamera& camera, OrderPtr base);
  void run();
  void apply(EditQueue::Waiting item) noexcept;
  void hold(const GaussianEdit& edit);
  OrderPtr sort(const Request& request) noexcept;
  // Returns a view for each group.
  std::vector<SortView> viewsOf(const SplatCamera& camera) const;
  void sortAll(const Request& request, std::vector<std::uint32_t>& slots);
  void merge(const Request& request, std::vector<std::uint32_t>& merged);

  OrderPool& pool_;
  const Feed feed_;
  bool rests_;
  mutable std::mutex mutex_;
  std::condition_variable wake_, finished_;
  bool stop_ = false;
  EditQueue edits_;
  std::map<std::string, Request> requests_;
  std::map<std::string, OrderPtr> orders_;  // finished ones, by view that asked; null if none
  std::size_t bytes_ = 0;

  // For the worker's thread only.
  std::string map_id_;
  std::uint64_t round_ = 0, revision_ = 0;
  std::uint64_t begun_at_ = 0;  // revision since which only slots changed: no clear, no group moved
  bool out_of_memory_ = false;  // until the next clear
  std::uint32_t capacity_ = 0;  // as GaussianEdit::capacity
  SplatRows rows_;
  std::vector<std::uint64_t> changed_at_;    // revision of the last change, by row
  std::vector<std::uint64_t> page_changed_;  // revision of the last change, by SlotPage::place
  DepthOrder depth_order_{ThreadTeam::ofViewers()};
  std::thread thread_;
};

}  // namespace rosplat
