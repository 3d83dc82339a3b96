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
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/order/picture.hpp"
#include "rosplat_core/painter/depth_warp.hpp"
#include "rosplat_core/painter/painted_map.hpp"
#include "rosplat_core/painter/picture_mesh.hpp"
#include "rosplat_core/raster/cpu_rasterizer.hpp"
#include "rosplat_core/views/camera_motion.hpp"
#include "rosplat_core/views/pick.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

using PaintedPicture = Picture<PaintedMapPtr>;

// What a view is to show. An order that is outdated isn't drawn.
struct PaintRequest : PaintedPicture {
  PaintRequest() = default;
  explicit PaintRequest(PaintedPicture of) : PaintedPicture(std::move(of)) {}

  std::vector<float> scene_depth, translucent_depth;  // as PictureRequest has them
  // How the camera moves. The picture is painted for where the camera will be, if it goes on so, in
  // the middle of the time for which the picture is shown.
  CameraMotion motion;
  bool window = false;         // the picture is for a window
  bool rests = false;          // the picture shown has this camera and map already, in less detail
  std::uint64_t age_tick = 0;  // in DrawMode::kAge the time, so that later requests differ

  bool interactive() const { return settings().interactive; }
  // Returns the layer of a map; null if there is none.
  const Layer<PaintedMapPtr>* of(const PaintedMap& map) const;

  // Whether both ask for the same picture, whatever the states of its maps.
  bool operator==(const PaintRequest& o) const;
};
using PaintRequestPtr = std::shared_ptr<const PaintRequest>;

// A part of a picture for a window: values by pixel, and which cells of the mesh show any of them.
template <typename T>
struct PaintedPart {
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
  // What the picture shows of a map.
  struct OfMap {
    MapState map;
    OrderPtr order;            // the order drawn; null: by depth, or unsorted
    std::size_t drawn = 0;     // splats and nodes
    double error = 0;          // as SplatPicture::OfLayer [px]
    std::string detail_error;  // why the map isn't in the detail that was asked for
  };

  PaintRequestPtr request;     // the request, with its camera moved on by the motion
  std::vector<OfMap> maps;     // by layer
  double asked = 0, took = 0;  // time of the request on a monotonic clock, and duration [s]
  double due = 0;              // when the moving camera reaches the request's camera [s]
  std::string error;           // why the picture failed; empty if it is good
  bool settled = true;         // another picture would be the same
  std::map<std::string, double> profile;

  SplatPicture picture;  // empty if the request is interactive: then only a window shows it
  // For windows only: premultiplied RGBA, with as many bits as windows have.
  PaintedPart<std::uint8_t> colour, behind;
  PaintedPart<float> hiding;  // window depth of `behind`, where that hides what is farther
  PictureMesh mesh;
  PaintedSurface surface;
};
using PaintingPtr = std::shared_ptr<const Painting>;

// Paints pictures of maps in a thread of its own, so that the render thread never waits. Uses no
// OpenGL.
class Painter {
 public:
  Painter();
  ~Painter();

  // Any thread may call all of these.

  // Takes the edits of a map from now on.
  void add(PaintedMapPtr map);
  // Takes no more edits of a map.
  void remove(const PaintedMapPtr& map);
  // Tells that edits wait. The painter takes them before the next picture, or at once if idle.
  void wake();
  // Asks for a picture of a view. Replaces a request of the view that still waits.
  void ask(const std::string& view_id, PaintRequestPtr request);
  // Cancels the picture of a view that is being painted if a newer one was asked for. Never cancels
  // two in a row.
  void hurry(const std::string& view_id);
  // The newest finished picture of a view, null if there is none.
  PaintingPtr newest(const std::string& view_id) const;
  // Waits until all edits are taken and the picture is painted. Throws PictureError.
  PaintingPtr paintNow(const std::string& view_id, PaintRequestPtr request);
  void forget(const std::string& view_id);

  // Has the splats found that a picture shows, ahead of all painting. Returns a Pick by layer;
  // Pick::slots() throws PictureError if that fails.
  std::vector<Pick> pick(PaintRequest asked);
  std::size_t bytes() const { return workspace_; }  // without the maps
  const char* instructions() const { return rasterizer_.instructions(); }

  // The clock of `change` in packed_slot.hpp.
  double clock() const;

 private:
  struct Waiting {
    std::uint64_t number = 0;
    PaintRequestPtr request;
    std::shared_ptr<Painting> painting;  // to be filled; allocated early, to tell of failures
    double asked = 0;                    // when [s]
    double takes = 0;                    // estimate, from the last picture [s]
  };
  using GivenUp = std::shared_ptr<std::atomic<bool>>;
  struct PickJob {
    PaintRequest asked;
    std::vector<std::promise<Pick::Slots>> slots;  // of each layer
    GivenUp given_up = std::make_shared<std::atomic<bool>>(false);
  };
  struct ViewPaintings {
    std::optional<Waiting> waiting;
    std::uint64_t painted = 0;  // Waiting::number of the newest finished picture
    PaintingPtr newest;
    bool given_up = false;  // hurry() cancelled the last picture
  };

  void run();
  bool hasWork() const { return stop_ || edits_ || !queue_.empty() || !picks_.empty(); }
  bool paints(const std::string& view_id) const {
    return !painting_.empty() && painting_.front() == view_id;
  }
  // Called and left with mutex_ locked. If one fails, the next work is tried all the same.
  void findNext(std::unique_lock<std::mutex>& lock);
  void paintNext(std::unique_lock<std::mutex>& lock);
  void goOnWithMaps();
  std::vector<PaintedMapPtr> maps() const;
  void takeEdits(const std::vector<PaintedMapPtr>& maps, std::size_t most_bytes);
  PictureRequest pictureOf(const PaintRequest& asked) const;
  // Has the maps forget former views. view_id: the view that is to show these layers.
  void keepViews(const std::vector<PaintedMapPtr>& maps, const std::string& view_id,
                 const PaintedPicture& shown);
  void chooseDetail(const std::string& view_id, PictureRequest& request, Painting& painting) const;
  static PaintRequestPtr movedOn(const PaintRequest& request, double seconds);
  // Returns false if cancelled.
  bool paint(const std::string& view_id, const Waiting& job);
  bool draw(const std::string& view_id, const Waiting& job);
  void find(PickJob& job);
  std::uint64_t enqueue(const std::string& view_id, PaintRequestPtr&& request);

  const double start_;

  mutable std::mutex mutex_;  // guards what follows, down to picking_
  std::condition_variable wake_, finished_;
  bool stop_ = false, edits_ = false;
  std::vector<PaintedMapPtr> maps_;
  std::map<std::string, ViewPaintings> views_;
  std::list<std::string> queue_;     // views that wait, the longest wait first
  std::list<std::string> painting_;  // the view that is being painted, if any
  std::uint64_t asked_ = 0;          // requests so far
  bool refining_ = false;            // the request being painted has PaintRequest::rests
  std::deque<PickJob> picks_;
  GivenUp picking_;  // of the PickJob in progress, if any
  std::atomic<bool> cancelled_{false};

  // For the painter's thread only; workspace_ for any.
  const std::shared_ptr<ThreadTeam> team_ = ThreadTeam::ofViewers();
  CpuRasterizer rasterizer_{team_};
  SplatPicture picture_;
  std::atomic<std::size_t> workspace_{0};
  std::thread thread_;
};

}  // namespace rosplat
