// How it works. One thread finds picks, paints and takes edits; run() tries these in turn:
// 1. findNext: a pick. The picture that is being painted is cancelled, and begun anew afterwards.
// 2. paintNext: the view that has waited longest. takeEdits, chooseDetail, CpuRasterizer::draw
//    until the budget of the detail is kept; then what a window needs: 8-bit colours, a mesh, a
//    surface.
// 3. goOnWithMaps: edits and levels of detail, while no picture is asked for.
// A picture that follows a camera is painted for where that will be in the middle of the time for
// which it is shown (movedOn). The render thread never waits: it warps the newest painting to its
// own camera, by a mesh at the splats' mean depth (Mark et al. 1997, "Post-rendering 3D warping").
// At rest, a camera gets its exact picture.

#include "rosplat_core/painter/painter.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <new>
#include <set>
#include <utility>

#include "rosplat_core/threads/clock.hpp"
#include "rosplat_core/threads/give_way.hpp"

namespace rosplat {

namespace {

// A map that streams in is painted after each part of this size [bytes].
constexpr std::size_t kEditBytesPerPicture = std::size_t{256} << 20;
constexpr double kFarthestAhead = 0.5;  // longest prediction of a camera's motion [s]
constexpr std::size_t kEverything = std::numeric_limits<std::size_t>::max();

using Cover = PictureMesh::Cover;

PictureMesh::Cells cellsOf(const std::vector<std::uint8_t>& rgba, int width, int height,
                           ThreadTeam& team) {
  return PictureMesh::cells(width, height, &team, [&rgba](std::size_t first, std::size_t count) {
    std::uint32_t all = ~0u, some = 0;
    for (std::size_t i = first; i < first + count; ++i) {
      std::uint32_t pixel;
      std::memcpy(&pixel, &rgba[4 * i], sizeof(pixel));
      all &= pixel;
      some |= pixel;
    }
    std::array<std::uint8_t, 4> of_all, of_some;
    std::memcpy(&of_all, &all, sizeof(all));
    std::memcpy(&of_some, &some, sizeof(some));
    return of_all[3] == 255 ? Cover::kAll : of_some[3] > 0 ? Cover::kSome : Cover::kNothing;
  });
}

// The colours as bytes. Clamped before blending: brighter than white stays white over anything.
PaintedPart<std::uint8_t> colourLayer(const SplatPicture& picture, ThreadTeam& team) {
  constexpr std::size_t kPart = 1 << 16;  // values
  PaintedPart<std::uint8_t> layer;
  const std::size_t all = picture.colour.size();
  layer.values.resize(all);
  inParts(&team, (all + kPart - 1) / kPart, [&](std::size_t part) {
    const std::size_t first = part * kPart;
    toBytes(&picture.colour[first], std::min(kPart, all - first), &layer.values[first]);
  });
  layer.cells = cellsOf(layer.values, picture.width, picture.height, team);
  return layer;
}

// Calls each(first pixel, count) for the rows of pixels of each divided tile.
template <typename Each>
void forDivided(const SplatPicture& picture, const Each& each) {
  constexpr int kTile = PictureMesh::kCell;
  const int across = (picture.width + kTile - 1) / kTile;
  for (std::size_t tile = 0; tile < picture.divided.size(); ++tile) {
    if (!picture.divided[tile]) continue;
    const int left = kTile * (int(tile) % across), top = kTile * (int(tile) / across);
    const auto count = std::size_t(std::min(kTile, picture.width - left));
    for (int y = top; y < std::min(top + kTile, picture.height); ++y) {
      each(std::size_t(y) * std::size_t(picture.width) + std::size_t(left), count);
    }
  }
}

// The splats behind translucent objects, as bytes.
PaintedPart<std::uint8_t> behindLayer(const SplatPicture& picture, ThreadTeam& team) {
  PaintedPart<std::uint8_t> layer;
  if (picture.behind.empty()) return layer;
  layer.values.resize(picture.behind.size());
  forDivided(picture, [&](std::size_t first, std::size_t count) {
    toBytes(&picture.behind[4 * first], 4 * count, &layer.values[4 * first]);
  });
  layer.cells = cellsOf(layer.values, picture.width, picture.height, team);
  return layer;
}

// The mean window depth of the splats behind translucent objects; 1 where their alpha is below 0.5.
PaintedPart<float> hidingLayer(const SplatPicture& picture, ThreadTeam& team) {
  PaintedPart<float> layer;
  const std::vector<float>& nearness = picture.nearness;
  if (nearness.empty()) return layer;
  std::vector<float>& depths = layer.values;
  depths.assign(nearness.size() / 2, 1.0f);
  forDivided(picture, [&](std::size_t first, std::size_t count) {
    for (std::size_t i = first; i < first + count; ++i) {
      if (nearness[2 * i + 1] >= 0.5f) depths[i] = 1.0f - nearness[2 * i] / nearness[2 * i + 1];
    }
  });
  layer.cells = PictureMesh::cells(
      picture.width, picture.height, &team, [&depths](std::size_t first, std::size_t count) {
        const float* const in_row = &depths[first];
        const bool some = std::count_if(in_row, in_row + count, [](float d) { return d < 1; }) > 0;
        return some ? Cover::kSome : Cover::kNothing;
      });
  return layer;
}

// Why a picture failed, in fewer words if the longer text finds no memory.
std::string reason(const std::exception& error, const SplatCamera& camera) noexcept {
  try {
    if (!dynamic_cast<const std::bad_alloc*>(&error)) return error.what();
    return "there is no memory for a picture of " + std::to_string(camera.width) + "x" +
           std::to_string(camera.height) + " pixels";
  } catch (const std::bad_alloc&) {
    return "out of memory";  // short enough for a string without an allocation
  }
}

// Locks a request's maps while they are drawn, and holds copies of their states.
class LockedMaps {
 public:
  LockedMaps(const PaintRequest& asked, PictureRequest& request) : states_(asked.layers.size()) {
    for (std::size_t i = 0; i < asked.layers.size(); ++i) {
      locks_.push_back(asked.layers[i].map->lock());
      states_[i] = asked.layers[i].map->state();
      request.layers[i].map = &states_[i];
    }
  }
  const std::vector<MapState>& states() const { return states_; }

 private:
  std::vector<std::shared_lock<std::shared_mutex>> locks_;
  std::vector<MapState> states_;
};

}  // namespace

const Layer<PaintedMapPtr>* PaintRequest::of(const PaintedMap& map) const {
  const auto found = std::find_if(layers.begin(), layers.end(),
                                  [&map](const auto& layer) { return layer.map.get() == &map; });
  return found == layers.end() ? nullptr : &*found;
}

bool PaintRequest::operator==(const PaintRequest& o) const {
  const auto same = [](const Layer<PaintedMapPtr>& a, const Layer<PaintedMapPtr>& b) {
    return a.map == b.map && a.camera == b.camera && a.camera.ndc_scale == b.camera.ndc_scale &&
           a.camera.ndc_offset == b.camera.ndc_offset && a.settings.projectsAs(b.settings) &&
           a.settings.interactive == b.settings.interactive;
  };
  return std::equal(layers.begin(), layers.end(), o.layers.begin(), o.layers.end(), same) &&
         order() == o.order() && unsorted() == o.unsorted() && age_tick == o.age_tick &&
         motion == o.motion && window == o.window && scene_depth == o.scene_depth &&
         translucent_depth == o.translucent_depth;
}

Painter::Painter() : start_(now()), thread_([this] { run(); }) {}

Painter::~Painter() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
    cancelled_ = true;
    if (picking_) *picking_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

double Painter::clock() const { return std::fmod((now() - start_) * kTicksPerSecond, 65536.0); }

void Painter::wake() {
  {
    const std::lock_guard lock(mutex_);
    edits_ = true;
  }
  wake_.notify_one();
}

void Painter::add(PaintedMapPtr map) {
  const std::lock_guard lock(mutex_);
  maps_.push_back(std::move(map));
  edits_ = true;
  wake_.notify_one();
}

void Painter::remove(const PaintedMapPtr& map) {
  const std::lock_guard lock(mutex_);
  maps_.erase(std::remove(maps_.begin(), maps_.end(), map), maps_.end());
  edits_ = true;  // so that what the painter knows of it goes
  wake_.notify_one();
}

std::uint64_t Painter::enqueue(const std::string& view_id, PaintRequestPtr&& request) {
  ViewPaintings& view = views_[view_id];
  auto painting = std::make_shared<Painting>();
  if (!view.waiting) queue_.push_back(view_id);
  if (paints(view_id) && refining_ && !request->rests) cancelled_ = true;
  view.waiting = Waiting{++asked_, std::move(request), std::move(painting), now(), 0};
  wake_.notify_one();
  return asked_;
}

void Painter::ask(const std::string& view_id, PaintRequestPtr request) {
  const std::lock_guard lock(mutex_);
  enqueue(view_id, std::move(request));
}

void Painter::hurry(const std::string& view_id) {
  const std::lock_guard lock(mutex_);
  const auto found = views_.find(view_id);
  if (found == views_.end() || !found->second.waiting || found->second.given_up) return;
  if (paints(view_id)) cancelled_ = found->second.given_up = true;
}

PaintingPtr Painter::newest(const std::string& view_id) const {
  const std::lock_guard lock(mutex_);
  const auto found = views_.find(view_id);
  return found == views_.end() ? nullptr : found->second.newest;
}

PaintingPtr Painter::paintNow(const std::string& view_id, PaintRequestPtr request) {
  std::unique_lock lock(mutex_);
  const std::uint64_t number = enqueue(view_id, std::move(request));
  views_[view_id].newest = nullptr;  // frees its memory for the new picture
  finished_.wait(lock, [&] { return views_[view_id].painted >= number; });
  PaintingPtr painting = views_[view_id].newest;
  if (!painting->error.empty()) throw PictureError(painting->error);
  return painting;
}

void Painter::forget(const std::string& view_id) {
  const std::lock_guard lock(mutex_);
  views_.erase(view_id);
  queue_.remove(view_id);
  if (paints(view_id)) cancelled_ = true;
  edits_ = true;  // wakes the painter: the view's levels may go
  wake_.notify_one();
}

void Painter::run() {
  giveWay();
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return hasWork(); });
    if (stop_) return;
    cancelled_ = false;
    if (!picks_.empty()) {
      findNext(lock);
    } else if (!queue_.empty()) {
      paintNext(lock);
    } else {
      edits_ = false;
      lock.unlock();
      goOnWithMaps();
      lock.lock();
    }
  }
}

void Painter::findNext(std::unique_lock<std::mutex>& lock) {
  PickJob job = std::move(picks_.front());
  picks_.pop_front();
  picking_ = job.given_up;
  lock.unlock();
  find(job);
  lock.lock();
  picking_.reset();
  edits_ = true;  // pick() may have interrupted work on edits and levels
}

void Painter::paintNext(std::unique_lock<std::mutex>& lock) {
  edits_ = false;
  painting_.splice(painting_.end(), queue_, queue_.begin());
  const std::string& view_id = painting_.front();
  ViewPaintings& asked = views_.at(view_id);
  Waiting job = *std::exchange(asked.waiting, std::nullopt);
  if (asked.newest) job.takes = asked.newest->took;
  refining_ = job.request->rests;
  lock.unlock();
  const bool whole = paint(view_id, job);
  lock.lock();
  const auto found = views_.find(view_id);
  if (found != views_.end() && whole) {
    found->second.newest = job.painting;
    found->second.painted = job.number;
    found->second.given_up = false;
    finished_.notify_all();
  } else if (found != views_.end() && !found->second.waiting) {  // cancelled for a pick
    found->second.waiting = std::move(job);
    queue_.splice(queue_.begin(), painting_);
  }
  painting_.clear();
}

// The work while no picture is asked for.
void Painter::goOnWithMaps() {
  try {
    const std::vector<PaintedMapPtr> maps = this->maps();
    keepViews(maps, "", {});
    takeEdits(maps, kEverything);
    for (const PaintedMapPtr& map : maps) {
      map->goOnWithLevels([this] {
        const std::lock_guard own(mutex_);
        return hasWork();
      });
    }
  } catch (const std::bad_alloc&) {  // the next picture tries the rest
  }
}

std::vector<PaintedMapPtr> Painter::maps() const {
  const std::lock_guard lock(mutex_);
  return maps_;
}

void Painter::takeEdits(const std::vector<PaintedMapPtr>& maps, std::size_t most_bytes) {
  bool all = true;
  for (const PaintedMapPtr& map : maps) {
    all = map->takeEdits(most_bytes, cancelled_, clock()) && all;
  }
  if (all) return;
  const std::lock_guard lock(mutex_);
  edits_ = true;  // some are left
}

void Painter::keepViews(const std::vector<PaintedMapPtr>& maps, const std::string& view_id,
                        const PaintedPicture& shown) {
  std::set<std::string> views;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, view] : views_) views.insert(id);
  }
  for (const PaintedMapPtr& map : maps) {
    const auto wants = [&](const Layer<PaintedMapPtr>& layer) {
      return layer.map == map && !shown.unsorted() && !(layer.settings.drawnDetail() == Detail{});
    };
    const bool wanted = std::any_of(shown.layers.begin(), shown.layers.end(), wants);
    map->keepViews(
        [&](const std::string& id) { return views.count(id) > 0 && (wanted || id != view_id); });
  }
}

PictureRequest Painter::pictureOf(const PaintRequest& asked) const {
  PictureRequest request;
  for (const auto& layer : asked.layers) {
    PictureLayer& drawn = request.layers.emplace_back();
    drawn.slots = &layer.map->slots();
    drawn.camera = layer.camera;
    drawn.settings = layer.settings;
  }
  request.now = clock();
  request.scene_depth = asked.scene_depth;
  request.translucent_depth = asked.translucent_depth;
  return request;
}

void Painter::chooseDetail(const std::string& view_id, PictureRequest& request,
                           Painting& painting) const {
  const PaintRequest& asked = *painting.request;
  const bool waited_for = !asked.interactive();
  for (std::size_t i = 0; i < asked.layers.size(); ++i) {
    const auto& layer = asked.layers[i];
    if (layer.settings.drawnDetail() == Detail{}) continue;
    if (asked.order() || asked.unsorted()) {
      painting.maps[i].detail_error = "a given order has no levels of detail";
      continue;
    }
    const double start = now();
    PaintedMap::Chosen chosen = layer.map->chooseDetail(
        view_id,
        [&](double patience) { return cancelled_ || (!waited_for && now() > start + patience); },
        request.layers[i]);
    painting.settled = painting.settled && chosen.settled;
    painting.maps[i].detail_error = std::move(chosen.error);
  }
}

// Returns the request with its camera moved on for a time [s], and with depths as seen from there.
PaintRequestPtr Painter::movedOn(const PaintRequest& request, double seconds) {
  auto later = std::make_shared<PaintRequest>();
  later->layers = request.layers;
  later->window = request.window;
  for (auto& layer : later->layers) {
    layer.camera = moved(layer.camera, request.motion, seconds);
  }
  const SplatCamera &camera = request.camera(), &there = later->camera();
  later->scene_depth = warpDepths(request.scene_depth, camera, there);
  later->translucent_depth = warpDepths(request.translucent_depth, camera, there);
  return later;
}

bool Painter::paint(const std::string& view_id, const Waiting& job) {
  bool whole = true;
  try {
    const bool interactive = job.request->interactive();
    {
      const std::vector<PaintedMapPtr> maps = this->maps();
      takeEdits(maps, interactive ? kEditBytesPerPicture : kEverything);
      keepViews(maps, view_id, *job.request);
    }
    whole = draw(view_id, job);
  } catch (const std::exception& error) {
    *job.painting = {};
    job.painting->request = job.request;
    job.painting->error = reason(error, job.request->camera());
  }
  workspace_ = rasterizer_.bytes();
  return whole;
}

bool Painter::draw(const std::string& view_id, const Waiting& job) {
  const double start = now();
  Painting& painting = *job.painting = {};
  painting.request = job.request;
  painting.maps.resize(job.request->layers.size());
  painting.asked = painting.due = job.asked;
  if (job.takes > 0 && !job.request->motion.none()) {
    // The picture will be shown from start + takes until the next is painted, at start + 2 * takes.
    const double ahead = std::min(start - job.asked + 1.5 * job.takes, kFarthestAhead);
    painting.request = movedOn(*job.request, ahead);
    painting.due += ahead;
  }
  const PaintRequest& asked = *painting.request;
  PictureRequest request = pictureOf(asked);
  request.depth = PictureDepth::kMean;
  request.planes = job.request->motion.none();  // a moving camera shows a mesh, which needs none
  request.cancelled = &cancelled_;
  chooseDetail(view_id, request, painting);
  {
    const LockedMaps maps(asked, request);
    const MapState& state = maps.states().front();
    const OrderPtr order = asked.order();
    if (order && order->map_id == state.id && order->revision == state.revision) {
      painting.maps.front().order = order;
      request.order = order->slots;
    }
    std::vector<std::uint32_t> all;
    if (asked.unsorted()) {
      all = asked.map()->slots().index().slots(state.capacity);
      request.order = all;
    }
    for (std::size_t i = 0; i < maps.states().size(); ++i) {
      painting.maps[i].map = maps.states()[i];
    }
    bool again = true;
    while (std::exchange(again, false)) {
      if (!rasterizer_.draw(request, picture_)) return false;
      for (std::size_t i = 0; i < asked.layers.size(); ++i) {
        PictureLayer& layer = request.layers[i];
        const auto& drawn = picture_.layers[i];
        const auto error = asked.layers[i].map->adjustDetail(view_id, layer, drawn, now() - start);
        layer.error = error.value_or(layer.error);
        again = again || error;
      }
    }
  }
  for (std::size_t i = 0; i < asked.layers.size(); ++i) {
    painting.maps[i].drawn = picture_.layers[i].drawn;
    painting.maps[i].error = picture_.layers[i].error;
    std::string& problem = painting.maps[i].detail_error;
    if (!request.layers[i].levels || !problem.empty()) continue;
    problem = asked.layers[i].map->detailProblem(view_id);
  }
  painting.profile = picture_.profile;
  if (asked.window) {
    painting.mesh = PictureMesh(asked.camera(), picture_);
    painting.colour = colourLayer(picture_, *team_);
    painting.behind = behindLayer(picture_, *team_);
    painting.hiding = hidingLayer(picture_, *team_);
    painting.surface = PaintedSurface(
        asked.camera(), asked.interactive() ? std::move(picture_.depth) : picture_.depth);
  }
  if (!asked.interactive()) painting.picture = std::exchange(picture_, {});
  painting.took = now() - start;
  return true;
}

std::vector<Pick> Painter::pick(PaintRequest asked) {
  PickJob job;
  job.slots.resize(asked.layers.size());
  job.asked = std::move(asked);
  const std::shared_ptr<void> wanted(nullptr, [up = job.given_up](void*) { *up = true; });
  std::vector<Pick> picks;
  for (auto& slots : job.slots) picks.emplace_back(slots.get_future(), wanted);
  const std::lock_guard lock(mutex_);
  picks_.push_back(std::move(job));
  cancelled_ = true;  // the picture being painted waits for the pick
  wake_.notify_one();
  return picks;
}

void Painter::find(PickJob& job) {
  try {
    PictureRequest request = pictureOf(job.asked);
    request.cancelled = job.given_up.get();
    const LockedMaps maps(job.asked, request);
    const std::vector<PickedSplat> picked = rasterizer_.pick(request);
    std::vector<Pick::Slots> found(job.slots.size(), Pick::Slots(picked.size(), kNoSlot));
    for (std::size_t i = 0; i < picked.size(); ++i) {
      if (picked[i].slot != kNoSlot) found[picked[i].layer][i] = picked[i].slot;
    }
    for (std::size_t layer = 0; layer < found.size(); ++layer) {
      job.slots[layer].set_value(std::move(found[layer]));
    }
  } catch (...) {
    for (auto& slots : job.slots) slots.set_exception(std::current_exception());
  }
  workspace_ = rasterizer_.bytes();
}

}  // namespace rosplat
