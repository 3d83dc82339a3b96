#pragma once

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <future>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/painter/painted_map.hpp"
#include "rosplat_core/painter/painted_surface.hpp"
#include "rosplat_core/painter/picture_mesh.hpp"
#include "rosplat_core/raster/cpu_rasterizer.hpp"
#include "rosplat_core/views/camera_motion.hpp"
#include "rosplat_core/views/pick.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// What a view is to show of a map.
struct PaintLayer {
  PaintedMapPtr map;
  SplatCamera camera;  // in its frame; see PictureRequest::layers
  RenderSettings settings;
  OrderPtr order;         // where the map still is as it says, of one layer alone; else by depth
  bool unsorted = false;  // or by nobody: as the slots are numbered
  std::uint64_t age_tick = 0;  // of what is coloured by age: the time

  bool operator==(const PaintLayer& o) const;
};

// What a view is to show.
struct PaintRequest {
  std::vector<PaintLayer> layers;                     // at least one
  std::vector<float> scene_depth, translucent_depth;  // as PictureRequest has them
  // How its camera moves: if it goes on like that, what is painted is what is seen in the middle of
  // the time in which that is shown.
  CameraMotion motion;
  bool window = false;  // it goes on a window
  bool rests = false;   // what is shown is of this camera and map already, in less detail

  const SplatCamera& camera() const { return layers.front().camera; }
  bool interactive() const { return layers.front().settings.interactive; }
  // How it sees a map; null where it doesn't show that.
  const PaintLayer* of(const PaintedMap& map) const;

  bool operator==(const PaintRequest& o) const;
};
using PaintRequestPtr = std::shared_ptr<const PaintRequest>;

// What a window is shown of a picture: values by pixel, and the cells of its mesh where any matter.
template <typename T>
struct PaintedLayer {
  std::vector<T> values;
  PictureMesh::Cells cells;

  bool shows() const {
    return std::any_of(cells.begin(), cells.end(), [](PictureMesh::Cover cover) {
      return cover != PictureMesh::Cover::kNothing;
    });
  }
};

// A picture of a view.
struct Painting {
  // What it shows of a map.
  struct OfMap {
    MapState map;
    OrderPtr order;            // that it is drawn in; null: by depth, or by nobody's
    std::size_t drawn = 0;     // splats and nodes
    double error = 0;          // as SplatPicture has it [px]
    std::string detail_error;  // why it is not in the detail that was asked for
  };

  PaintRequestPtr request;     // as it was asked for, or of a camera that has moved on
  std::vector<OfMap> maps;     // by layer
  double asked = 0, took = 0;  // when, of a monotonic clock, and how long [s]
  double due = 0;              // when its camera is there, if it goes on as it moves [s]
  std::string error;           // why it failed; empty if it is good
  bool settled = true;         // another picture would be the same
  std::map<std::string, double> profile;

  SplatPicture picture;  // unless it is interactive: then only a window sees it
  // For windows: premultiplied RGBA, as many bits as they have.
  PaintedLayer<std::uint8_t> colour, behind;
  PaintedLayer<float> hiding;  // window depth of what is behind translucent objects and hides them
  PictureMesh mesh;
  PaintedSurface surface;
};
using PaintingPtr = std::shared_ptr<const Painting>;

// Paints pictures of maps in a thread of its own, so that the render thread never waits. Knows no
// OpenGL.
class Painter {
 public:
  Painter();
  ~Painter();

  // All of these from any thread.

  // Takes the edits of a map from now on.
  void add(PaintedMapPtr map);
  // Takes no more edits of a map.
  void remove(const PaintedMapPtr& map);
  // Says that there are edits. They are taken before the next picture, or at once if none waits.
  void wake();
  // Asks for a picture of a view, in place of the request that waits for it.
  void ask(const std::string& view_id, PaintRequestPtr request);
  // Gives up the picture that is being painted of a view, if a newer one was asked for; never twice
  // in a row.
  void hurry(const std::string& view_id);
  // The newest finished picture of a view, null if there is none.
  PaintingPtr newest(const std::string& view_id) const;
  // Waits for the whole maps and a picture of them. Throws PictureError.
  PaintingPtr paintNow(const std::string& view_id, PaintRequestPtr request);
  void forget(const std::string& view_id);

  // Has the splats found that a picture shows, before anything is painted; where that fails, by
  // PictureError. Those of each layer.
  std::vector<Pick> pick(PaintRequest asked);
  std::size_t bytes() const { return workspace_; }  // beside the maps
  const char* instructions() const { return rasterizer_.instructions(); }

  // Of `change` in packed_slot.hpp.
  double clock() const;

 private:
  struct Waiting {
    std::uint64_t number = 0;
    PaintRequestPtr request;
    std::shared_ptr<Painting> painting;  // what it is to become, or why that fails
    double asked = 0;
    double takes = 0;  // probably [s]
  };
  using GivenUp = std::shared_ptr<std::atomic<bool>>;
  struct PickJob {
    PaintRequest asked;
    std::vector<std::promise<Pick::Slots>> slots;  // of each layer
    GivenUp given_up = std::make_shared<std::atomic<bool>>(false);
  };
  struct ViewPaintings {
    std::optional<Waiting> waiting;
    std::uint64_t painted = 0;  // number of the newest that is finished
    PaintingPtr newest;
    bool given_up = false;  // the last
  };

  void run();
  bool hasWork() const { return stop_ || edits_ || !queue_.empty() || !picks_.empty(); }
  bool paints(const std::string& view_id) const {
    return !painting_.empty() && painting_.front() == view_id;
  }
  // Of the work that there is, with the lock of what follows; whatever fails, the next is tried.
  void findNext(std::unique_lock<std::mutex>& lock);
  void paintNext(std::unique_lock<std::mutex>& lock);
  void goOnWithMaps();
  std::vector<PaintedMapPtr> maps() const;
  void takeEdits(const std::vector<PaintedMapPtr>& maps, std::size_t most_bytes);
  PictureRequest pictureOf(const PaintRequest& asked) const;
  // Has maps know which views there are, of which one is to show these layers.
  void keepViews(const std::vector<PaintedMapPtr>& maps, const std::string& view_id,
                 const std::vector<PaintLayer>& layers);
  void chooseDetail(const std::string& view_id, PictureRequest& request, Painting& painting) const;
  static PaintRequestPtr movedOn(const PaintRequest& request, double seconds);
  // False where it was given up.
  bool paint(const std::string& view_id, const Waiting& job);
  bool draw(const std::string& view_id, const Waiting& job);
  void find(PickJob& job);
  std::uint64_t enqueue(const std::string& view_id, PaintRequestPtr&& request);

  const double start_;

  mutable std::mutex mutex_;  // what follows
  std::condition_variable wake_, finished_;
  bool stop_ = false, edits_ = false;
  std::vector<PaintedMapPtr> maps_;
  std::map<std::string, ViewPaintings> views_;
  std::list<std::string> queue_;     // views, those first that have waited longest
  std::list<std::string> painting_;  // the view that was, if any
  std::uint64_t asked_ = 0;          // that ever were
  bool refining_ = false;            // it, for a camera that rests
  std::deque<PickJob> picks_;
  GivenUp picking_;  // what is being found, if anything
  std::atomic<bool> cancelled_{false};

  // The painter's own.
  CpuRasterizer rasterizer_;
  SplatPicture picture_;
  std::atomic<std::size_t> workspace_{0};
  std::thread thread_;
};

}  // namespace rosplat
