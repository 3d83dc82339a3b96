#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "cpu/cpu_rasterizer.hpp"
#include "cpu/painted_surface.hpp"
#include "cpu/picture_mesh.hpp"
#include "map/detail.hpp"
#include "map/gaussian_map.hpp"
#include "map/host_slots.hpp"
#include "map/levels.hpp"
#include "map/pick.hpp"
#include "map/render_settings.hpp"
#include "map/splat_camera.hpp"
#include "order/order.hpp"

namespace rosplat {

// What a view is to show.
struct PaintRequest {
  SplatCamera camera;
  RenderSettings settings;
  std::vector<float> scene_depth, translucent_depth;  // as PictureRequest has them
  OrderPtr order;                                     // null: by depth
  bool unsorted = false;                              // or by nobody: as the slots are numbered
  std::uint64_t age_tick = 0;                         // of what is coloured by age: the time
  bool window = false;                                // it goes on a window
  bool rests = false;  // what is shown is of this camera and map already, in less detail

  bool operator==(const PaintRequest& o) const;
};
using PaintRequestPtr = std::shared_ptr<const PaintRequest>;

// What a window is shown of a picture: values by pixel, and the cells of its mesh where any matter.
template <typename T>
struct PaintedLayer {
  std::vector<T> values;
  PictureMesh::Cells cells;
};

// A picture of a view.
struct Painting {
  PaintRequestPtr request;
  MapState map;                // that it shows
  double asked = 0, took = 0;  // when, of a monotonic clock, and how long [s]
  std::string error;           // why it failed; empty if it is good
  std::size_t drawn = 0;       // splats and nodes
  double error_px = 0;         // as SplatPicture::error
  bool settled = true;         // another picture would be the same
  std::string detail_error;    // why it is not in the detail that was asked for
  std::map<std::string, double> profile;

  SplatPicture picture;  // unless it is asynchronous: then only a window sees it
  // For windows: premultiplied RGBA, as many bits as they have.
  PaintedLayer<std::uint8_t> colour, behind;
  PaintedLayer<float> hiding;  // window depth of what is behind translucent objects and hides them
  PictureMesh mesh;
  PaintedSurface surface;
};
using PaintingPtr = std::shared_ptr<const Painting>;

// Paints the pictures of a map in a thread of its own, so that who shows them never waits. Knows no
// OpenGL.
class Painter {
 public:
  // Gives the next edit and the map's state after it; false where none waits. Any thread.
  using NextEdit = std::function<bool(std::shared_ptr<const GaussianEdit>&, MapState&)>;

  explicit Painter(NextEdit next_edit);
  ~Painter();

  // All of these from any thread.

  // There are edits. They are taken before the next picture, and where there is none.
  void wake();
  // Begins with a map that another has drawn so far: its pages, and its state.
  void hold(const GaussianEdit& page);
  void hold(const MapState& map);
  // Takes no more edits and paints no more.
  void stop();
  // What writes the map elsewhere: where its groups are, then a page of it at a time.
  void forEachPage(const std::function<void(const GaussianEdit&)>& take) const;
  // Has a view painted; in the place of what waits for it.
  void ask(const std::string& view_id, PaintRequestPtr request);
  // Has what is being painted of a view given up, for something that is asked for already; not
  // twice in a row.
  void hurry(const std::string& view_id);
  // The newest finished picture of a view; null where there is none.
  PaintingPtr newest(const std::string& view_id) const;
  // Waits for the whole map and a picture of it. Throws PictureError.
  PaintingPtr paintNow(const std::string& view_id, PaintRequestPtr request);
  void forget(const std::string& view_id);

  // Has the splats found that a picture shows, before anything is painted; where that fails, by
  // PictureError.
  Pick pick(PaintRequest asked);
  std::vector<SplatValues> read(const std::vector<std::uint32_t>& slots) const;
  MapState map() const;          // that is painted
  std::string mapError() const;  // why a part of it is missing, empty where none is
  std::size_t bytes() const;     // that map, levels and workspace take
  std::size_t mapBytes() const;
  std::size_t levelsBytes() const { return levels_bytes_; }
  const char* instructions() const { return rasterizer_.instructions(); }

  // Of `change` in packed_slot.hpp.
  double clock() const;

 private:
  struct Waiting {
    std::uint64_t number = 0;
    PaintRequestPtr request;
    double asked = 0;
  };
  struct PickJob {
    PaintRequest asked;
    std::promise<Pick::Slots> slots;
    Pick::GivenUp given_up = std::make_shared<std::atomic<bool>>(false);
  };
  struct View {
    std::optional<Waiting> waiting;
    std::uint64_t painted = 0;  // number of the newest that is finished
    PaintingPtr newest;
    bool given_up = false;  // the last
  };

  void run();
  void takeEdits(std::size_t most_bytes);
  void setMap(const MapState& map, const std::string& error);
  // Until `stop`; whether the levels hold all of the map.
  bool advanceLevels(const std::function<bool()>& stop);
  // Gives the levels back where no view wants any.
  void dropLevels();
  void chooseDetail(PictureRequest& request, const std::string& view_id, Painting& painting);
  PictureRequest pictureOf(const PaintRequest& asked) const;
  std::shared_ptr<Painting> paint(const std::string& view_id, const Waiting& job);
  void find(PickJob& job);
  std::uint64_t enqueue(const std::string& view_id, PaintRequestPtr&& request);

  NextEdit next_edit_;
  const double start_;

  mutable std::mutex mutex_;  // what follows
  std::condition_variable wake_, finished_;
  bool stop_ = false, edits_ = false;
  std::map<std::string, View> views_;
  std::deque<std::string> queue_;  // views, those first that have waited longest
  std::uint64_t asked_ = 0;        // that ever were
  std::string painting_;           // the view
  bool refining_ = false;          // it, for a camera that rests
  std::deque<PickJob> picks_;
  Pick::GivenUp picking_;  // what is being found, if anything
  std::atomic<bool> cancelled_{false};

  // With another lock than the slots, for which nobody who shows pictures shall wait.
  mutable std::mutex map_mutex_;  // what follows
  MapState map_;                  // of the slots
  std::string map_error_;
  std::size_t map_bytes_ = 0;

  mutable std::shared_mutex slots_mutex_;  // what follows; the painter paints with a shared lock
  HostSlots slots_;

  // The painter's own.
  CpuRasterizer rasterizer_;
  Levels levels_;
  std::map<std::string, DetailControl> controls_;  // of views that aren't painted in full
  bool wants_levels_ = false;                      // some of these do
  std::atomic<std::size_t> levels_bytes_{0};
  SplatPicture picture_;
  std::atomic<std::size_t> workspace_{0};
  std::thread thread_;
};

}  // namespace rosplat
