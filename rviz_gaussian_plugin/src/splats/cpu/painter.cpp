#include "cpu/painter.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <iterator>
#include <limits>
#include <new>

#include "map/give_way.hpp"

namespace rosplat {

namespace {

// So much of a map that streams in is taken before what there is of it is shown.
constexpr std::size_t kEditBytesPerPicture = std::size_t{256} << 20;
// So long pictures wait for levels of detail that aren't whole; then they do without. [s]
constexpr double kLevelsPerPicture = 0.03;
constexpr double kLevelsShare = 0.5;  // or for that part of the time that they take without
constexpr std::size_t kEverything = std::numeric_limits<std::size_t>::max();

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

template <typename T>
ArrayView<T> viewOf(const std::vector<T>& values) {
  return {values.data(), values.size()};
}

// As bytes. What is brighter than white stays white when it is laid over something.
PaintedLayer<std::uint8_t> colourLayer(const std::vector<float>& rgba, int width, int height) {
  PaintedLayer<std::uint8_t> layer;
  if (rgba.empty()) return layer;
  std::vector<std::uint8_t>& bytes = layer.values;
  bytes.resize(rgba.size());
  for (std::size_t i = 0; i < rgba.size(); ++i) {
    bytes[i] = static_cast<std::uint8_t>(std::min(std::max(rgba[i], 0.0f), 1.0f) * 255.0f + 0.5f);
  }
  layer.cells = PictureMesh::cells(
      width, height, [&bytes](std::size_t pixel) { return bytes[4 * pixel + 3] > 0; });
  return layer;
}

// The mean window depth of what is more opaque than not, 1 elsewhere.
PaintedLayer<float> hidingLayer(const std::vector<float>& nearness, int width, int height) {
  PaintedLayer<float> layer;
  if (nearness.empty()) return layer;
  std::vector<float>& depths = layer.values;
  depths.assign(nearness.size() / 2, 1.0f);
  for (std::size_t i = 0; i < depths.size(); ++i) {
    if (nearness[2 * i + 1] >= 0.5f) depths[i] = 1.0f - nearness[2 * i] / nearness[2 * i + 1];
  }
  layer.cells =
      PictureMesh::cells(width, height, [&depths](std::size_t pixel) { return depths[pixel] < 1; });
  return layer;
}

}  // namespace

bool PaintRequest::operator==(const PaintRequest& o) const {
  return camera == o.camera && camera.ndc_scale == o.camera.ndc_scale &&
         camera.ndc_offset == o.camera.ndc_offset && settings.projectsAs(o.settings) &&
         settings.depth_range == o.settings.depth_range && age_tick == o.age_tick &&
         order == o.order && unsorted == o.unsorted && window == o.window &&
         scene_depth == o.scene_depth && translucent_depth == o.translucent_depth;
}

Painter::Painter(NextEdit next_edit)
    : next_edit_(std::move(next_edit)),
      start_(now()),
      levels_(rosplat_sorter::ThreadTeam::ofViewers()),
      thread_([this] { run(); }) {}

Painter::~Painter() { stop(); }

void Painter::stop() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
    cancelled_ = true;
    if (picking_) *picking_ = true;
  }
  wake_.notify_all();
  if (thread_.joinable()) thread_.join();
}

double Painter::clock() const { return std::fmod((now() - start_) * kTicksPerSecond, 65536.0); }

void Painter::wake() {
  {
    const std::lock_guard lock(mutex_);
    edits_ = true;
  }
  wake_.notify_one();
}

void Painter::hold(const GaussianEdit& page) {
  const std::unique_lock lock(slots_mutex_);
  slots_.apply(page, clock());
}

void Painter::hold(const MapState& map) { setMap(map, ""); }

void Painter::setMap(const MapState& map, const std::string& error) {
  const std::size_t bytes = slots_.bytes();  // of which its writers are the only ones
  const std::lock_guard lock(map_mutex_);
  map_ = map;
  map_error_ = error;
  map_bytes_ = bytes;
}

void Painter::forEachPage(const std::function<void(const GaussianEdit&)>& take) const {
  const std::shared_lock lock(slots_mutex_);
  take(slots_.index().moves());
  for (const SlotPage& page : slots_.pages()) take(slots_.edit(page));
}

std::uint64_t Painter::enqueue(const std::string& view_id, PaintRequestPtr&& request) {
  View& view = views_[view_id];
  if (!view.waiting) queue_.push_back(view_id);
  if (painting_ == view_id && refining_ && !request->rests) cancelled_ = true;
  view.waiting = Waiting{++asked_, std::move(request), now()};
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
  if (painting_ == view_id) cancelled_ = found->second.given_up = true;
}

PaintingPtr Painter::newest(const std::string& view_id) const {
  const std::lock_guard lock(mutex_);
  const auto found = views_.find(view_id);
  return found == views_.end() ? nullptr : found->second.newest;
}

PaintingPtr Painter::paintNow(const std::string& view_id, PaintRequestPtr request) {
  std::unique_lock lock(mutex_);
  const std::uint64_t number = enqueue(view_id, std::move(request));
  finished_.wait(lock, [&] { return views_[view_id].painted >= number; });
  PaintingPtr painting = views_[view_id].newest;
  if (!painting->error.empty()) throw PictureError(painting->error);
  return painting;
}

void Painter::forget(const std::string& view_id) {
  const std::lock_guard lock(mutex_);
  views_.erase(view_id);
  queue_.erase(std::remove(queue_.begin(), queue_.end(), view_id), queue_.end());
  if (painting_ == view_id) cancelled_ = true;
  edits_ = true;  // for its levels may go
  wake_.notify_one();
}

void Painter::run() {
  giveWay();
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return stop_ || edits_ || !queue_.empty() || !picks_.empty(); });
    if (stop_) return;
    cancelled_ = false;
    if (!picks_.empty()) {
      PickJob job = std::move(picks_.front());
      picks_.pop_front();
      picking_ = job.given_up;
      lock.unlock();
      find(job);
      lock.lock();
      picking_.reset();
      edits_ = true;  // which may have been left for it
      continue;
    }
    edits_ = false;
    for (auto control = controls_.begin(); control != controls_.end();) {
      control = views_.count(control->first) ? std::next(control) : controls_.erase(control);
    }
    if (queue_.empty()) {
      lock.unlock();
      if (controls_.empty()) dropLevels();
      takeEdits(kEverything);
      if (wants_levels_) {
        advanceLevels([this] {
          const std::lock_guard own(mutex_);
          return stop_ || edits_ || !queue_.empty() || !picks_.empty();
        });
      }
      lock.lock();
      continue;
    }
    const std::string view_id = std::move(queue_.front());
    queue_.pop_front();
    Waiting job = *std::exchange(views_[view_id].waiting, std::nullopt);
    const std::uint64_t number = job.number;
    painting_ = view_id;
    refining_ = job.request->rests;
    lock.unlock();
    takeEdits(job.request->settings.asynchronous ? kEditBytesPerPicture : kEverything);
    if (job.request->settings.drawnDetail() == Detail{}) {
      controls_.erase(view_id);
      if (controls_.empty()) dropLevels();
    }
    const std::shared_ptr<Painting> painting = paint(view_id, job);
    lock.lock();
    painting_.clear();
    const auto found = views_.find(view_id);
    if (found == views_.end()) continue;
    if (!painting) {
      if (!found->second.waiting) {  // nothing newer: it was given up for a pick
        found->second.waiting = std::move(job);
        queue_.push_front(view_id);
      }
      continue;
    }
    found->second.newest = painting;
    found->second.painted = number;
    found->second.given_up = false;
    finished_.notify_all();
  }
}

void Painter::takeEdits(std::size_t most_bytes) {
  std::size_t taken = 0;
  std::shared_ptr<const GaussianEdit> edit;
  MapState state;
  while (taken < most_bytes && !cancelled_ && next_edit_(edit, state)) {
    const std::unique_lock lock(slots_mutex_);
    std::string error = edit->clear ? "" : mapError();
    if (edit->clear) levels_.clear();
    try {
      slots_.apply(*edit, clock());
      levels_.mark(slots_, edit->runs);
    } catch (const std::bad_alloc&) {  // the rest of the map is still worth seeing
      error = "there is no memory for all of the map";
    }
    taken += edit->slots.size() * sizeof(std::uint32_t);
    for (const auto& band : edit->bands) taken += band.size() * sizeof(std::uint32_t);
    for (const auto& channel : edit->channels) taken += channel.size() * sizeof(float);
    setMap(state, error);
  }
  if (taken < most_bytes) return;
  const std::lock_guard lock(mutex_);
  edits_ = true;  // the rest
}

bool Painter::advanceLevels(const std::function<bool()>& stop) {
  // Nobody else writes slots, nor looks at what this writes.
  const bool whole = levels_.advance(slots_, stop);
  levels_bytes_ = levels_.bytes();
  return whole;
}

void Painter::dropLevels() {
  wants_levels_ = false;
  if (levels_bytes_ == 0) return;
  levels_.clear();
  levels_bytes_ = 0;
  const std::unique_lock lock(slots_mutex_);
  slots_.dropParents();
}

void Painter::chooseDetail(PictureRequest& request, const std::string& view_id,
                           Painting& painting) {
  PictureLayer& layer = request.layers.front();
  const RenderSettings& settings = layer.settings;
  const Detail detail = settings.drawnDetail();
  if (detail == Detail{} || request.order || painting.request->unsorted) return;
  DetailControl& control = controls_[view_id];
  const bool in_time = detail.kind == Detail::Kind::kTime;
  const bool moves = settings.asynchronous && !painting.request->rests;
  if (!control.needsLevels(detail) || (in_time && !moves)) return;
  wants_levels_ = true;
  const double until = now() + std::max(kLevelsPerPicture, kLevelsShare * control.secondsInFull());
  try {
    const bool whole =
        advanceLevels([&] { return cancelled_ || (settings.asynchronous && now() > until); });
    if (levels_.nodes() == 0) {  // all is drawn until they stand
      painting.settled = whole || in_time;
      return;
    }
    layer.levels = &levels_;
    layer.error = control.choose(detail, !settings.asynchronous, levels_.groups(), layer.camera,
                                 slots_.index().groups(), settings.clip_box);
    if (detail.kind == Detail::Kind::kSplats && !settings.asynchronous) {
      layer.most_splats = static_cast<std::size_t>(detail.amount);
    }
    painting.settled = in_time ? layer.error == 0 : whole && control.settled();
  } catch (const std::bad_alloc&) {
    painting.detail_error = "there is no memory for levels of detail";
  }
}

PictureRequest Painter::pictureOf(const PaintRequest& asked) const {
  PictureRequest request;
  request.layers.resize(1);
  PictureLayer& layer = request.layers.front();
  layer.slots = &slots_;
  layer.camera = asked.camera;
  layer.settings = asked.settings;
  request.now = clock();
  request.scene_depth = viewOf(asked.scene_depth);
  request.translucent_depth = viewOf(asked.translucent_depth);
  return request;
}

std::shared_ptr<Painting> Painter::paint(const std::string& view_id, const Waiting& job) {
  const double start = now();
  auto painting = std::make_shared<Painting>();
  painting->asked = job.asked;
  painting->request = job.request;
  const PaintRequest& asked = *painting->request;
  try {
    PictureRequest request = pictureOf(asked);
    PictureLayer& layer = request.layers.front();
    if (asked.order) request.order = viewOf(asked.order->slots);
    request.mean_depth = true;
    request.cancelled = &cancelled_;
    chooseDetail(request, view_id, *painting);
    {
      const std::shared_lock lock(slots_mutex_);
      painting->map = map();
      layer.map = &painting->map;
      std::vector<std::uint32_t> all;
      if (asked.unsorted) {
        all = slots_.index().slots(painting->map.capacity);
        request.order = viewOf(all);
      }
      if (!rasterizer_.draw(request, picture_)) return nullptr;
    }
    painting->drawn = picture_.layers.front().drawn;
    painting->error_px = picture_.layers.front().error;
    const double took = now() - start;
    if (const auto found = controls_.find(view_id); found != controls_.end()) {
      DetailControl& control = found->second;
      if (layer.levels) {
        control.drew(painting->error_px);
        control.took(painting->error_px, took);
      } else {
        control.drewAll(took);
        wants_levels_ = wants_levels_ || control.needsLevels(asked.settings.drawnDetail());
      }
    }
    painting->profile = picture_.profile;
    if (asked.window) {
      const int width = picture_.width, height = picture_.height;
      painting->mesh = PictureMesh(asked.camera, picture_);
      painting->surface = PaintedSurface(asked.camera, picture_);
      painting->colour = colourLayer(picture_.colour, width, height);
      painting->behind = colourLayer(picture_.behind, width, height);
      painting->hiding = hidingLayer(picture_.nearness, width, height);
    }
    if (!asked.settings.asynchronous) painting->picture = std::exchange(picture_, {});
  } catch (const PictureError& error) {
    painting->error = error.what();
  } catch (const std::bad_alloc&) {
    painting->error = "there is no memory for a picture of " + std::to_string(asked.camera.width) +
                      "x" + std::to_string(asked.camera.height) + " pixels";
  }
  workspace_ = rasterizer_.bytes();
  painting->took = now() - start;
  return painting;
}

Pick Painter::pick(PaintRequest asked) {
  const std::lock_guard lock(mutex_);
  PickJob& job = picks_.emplace_back();
  job.asked = std::move(asked);
  cancelled_ = true;  // what is being painted comes after
  wake_.notify_one();
  return Pick(job.slots.get_future(), job.given_up);
}

void Painter::find(PickJob& job) {
  try {
    PictureRequest request = pictureOf(job.asked);
    request.cancelled = job.given_up.get();
    const std::shared_lock lock(slots_mutex_);
    const MapState map = this->map();
    request.layers.front().map = &map;
    Pick::Slots slots;
    for (const PickedSplat& picked : rasterizer_.pick(request)) slots.push_back(picked.slot);
    job.slots.set_value(std::move(slots));
  } catch (...) {
    job.slots.set_exception(std::current_exception());
  }
  workspace_ = rasterizer_.bytes();
}

std::vector<SplatValues> Painter::read(const std::vector<std::uint32_t>& slots) const {
  const std::shared_lock lock(slots_mutex_);
  return slots_.read(slots);
}

MapState Painter::map() const {
  const std::lock_guard lock(map_mutex_);
  return map_;
}

std::string Painter::mapError() const {
  const std::lock_guard lock(map_mutex_);
  return map_error_;
}

std::size_t Painter::mapBytes() const {
  const std::lock_guard lock(map_mutex_);
  return map_bytes_;
}

std::size_t Painter::bytes() const { return mapBytes() + levels_bytes_ + workspace_; }

}  // namespace rosplat
