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

// The viewer's own sorter: a worker with the positions of the map, so that no frame waits for a
// sort.
class BuiltInSorter {
 public:
  // Has apply() given the map as it is.
  using Feed = std::function<void()>;

  // The pool makes its orders, and must outlive it. With a feed, it holds nothing until the first
  // order is asked for; then it is fed, and takes edits from there on.
  explicit BuiltInSorter(OrderPool& pool, Feed feed = nullptr);
  ~BuiltInSorter();

  // Edits reach the worker in order, before any sort asked for later.
  void apply(EditQueue::Node edit) noexcept;
  // Lets the map go until an order is asked for again.
  void rest();

  // Sorts for a camera; a newer request for the same view replaces one that waits. With `base`, a
  // sidecar's order of an older revision, only the slots changed since are sorted and merged into
  // it.
  void request(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera,
               OrderPtr base = nullptr);

  // The newest finished order of a view, once.
  OrderPtr take(const std::string& view_id);

  // Sorts and waits for it.
  OrderPtr sortNow(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera);

  void forget(const std::string& view_id);
  // What it holds. Of a map that it has no memory for nothing, and its orders are empty and say so.
  std::size_t bytes() const;

 private:
  struct Request {
    SplatCamera camera;
    OrderPtr base;
    std::shared_ptr<Order> order;  // to be filled; until then, it says that memory is lacking
  };
  void begin();
  std::unique_lock<std::mutex> ask(const std::string& view_id, std::uint64_t sequence,
                                   const SplatCamera& camera, OrderPtr base);
  void run();
  void apply(EditQueue::Waiting item) noexcept;
  void hold(const GaussianEdit& edit);
  OrderPtr sort(const Request& request) noexcept;
  // Of each group.
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
  std::map<std::string, OrderPtr> orders_;  // of views that asked, null before there is one
  std::size_t bytes_ = 0;

  // The worker's own.
  std::string map_id_;
  std::uint64_t round_ = 0, revision_ = 0;
  std::uint64_t begun_at_ = 0;  // revision since which slots alone have changed
  bool out_of_memory_ = false;  // until the next clear
  std::uint32_t capacity_ = 0;  // as GaussianEdit::capacity
  SplatRows rows_;
  std::vector<std::uint64_t> changed_at_;    // revision of a row's last change
  std::vector<std::uint64_t> page_changed_;  // of a page's, by place
  DepthOrder depth_order_{ThreadTeam::ofViewers()};
  std::thread thread_;
};

}  // namespace rosplat
