#include "gpu/projection.hpp"

#include <algorithm>

#include "map/page_view.hpp"
#include "order/built_in_sorter.hpp"

namespace rosplat {

namespace {

void setView(const gl::Program& program, const rosplat_sorter::View& view) {
  glUniformMatrix3fv(program.at("rotation"), 1, GL_TRUE, view.rotation);
  glUniform3fv(program.at("translation"), 1, view.translation);
  program.set("clip", view.near_clip, view.far_clip);
  program.set("orthographic", int(view.orthographic));
}

}  // namespace

Projection::Projection(const Shaders& shaders, const Tallies& tallies)
    : cull_(shaders.compute({"splat_slot.glsl", "splat_pages.glsl", "splat_view.glsl",
                             "splat_visible.glsl", "splat_cull.comp"})),
      project_(shaders.compute({"splat_slot.glsl", "splat_pages.glsl", "splat_view.glsl",
                                "splat_visible.glsl", "splat_ellipses.glsl", "splat_tiles.glsl",
                                "splat_project.comp"})),
      prefix_sum_(shaders),
      part_size_(shaders.partSize()),
      words_(tallies.of(Tallies::kSlotWords)),
      visible_count_(tallies.of(Tallies::kVisible)),
      depth_range_(tallies.of(Tallies::kDepthRange)) {}

void Projection::reserve(std::size_t count) {
  if (count <= room_) return;
  if (count > Shaders::kEllipseParts * part_size_) {
    throw gl::Error("the graphics driver's buffers hold " +
                    std::to_string(Shaders::kEllipseParts * part_size_) +
                    " visible splats, this view has " + std::to_string(count));
  }
  room_ = 0;  // should there be no memory
  for (std::size_t part = 0; part * part_size_ < count; ++part) {
    ellipses_[part].reserve(std::min(part_size_, count - part * part_size_) *
                            Shaders::kEllipseBytes);
  }
  boxes_.reserve(count * sizeof(GLuint));
  room_ = count;
}

void Projection::run(const SlotStore& store, const SplatCamera& camera, const MapState& map,
                     const RenderSettings& settings, double now, const gl::Buffer& keys) {
  const std::array<GLuint, Tally::kBytes / sizeof(GLuint)> no_range{~0u};
  depth_range_.write(no_range.data());
  const rosplat_sorter::View view = sorterView(camera, map.origin, 1.0);
  pages_.keep(store, PageView(view, settings.clip_box, map.origin));
  if (pages_.count() == 0) {
    visible_count_.set(0);
    return;
  }
  cull(view, map, settings);
  project(store, view, camera, map, settings, now, keys);
}

void Projection::cull(const rosplat_sorter::View& view, const MapState& map,
                      const RenderSettings& settings) {
  const std::size_t words = slotWords();
  visible_.reserve(words * sizeof(GLuint));
  before_.reserve(words * sizeof(GLuint));
  prefix_sum_.reserve(words);
  words_.set(words);
  cull_.use();
  setView(cull_, view);
  cull_.set("focal", view.fx, view.fy);
  cull_.set("offset", view.offset_x, view.offset_y);
  cull_.set("half_size", view.half_width, view.half_height);
  cull_.set("slope", view.slope_x, view.slope_y);
  cull_.set("opacity_modifier", settings.opacity);
  const ClipBox& box = settings.clip_box;
  std::array<float, 3> box_centre{};
  for (int i = 0; i < 3; ++i) box_centre[i] = static_cast<float>(box.centre[i] - map.origin[i]);
  cull_.set("clip_to_box", int(box.enabled));
  glUniform3fv(cull_.at("box_centre"), 1, box_centre.data());
  glUniform3fv(cull_.at("box_size"), 1, box.size.data());
  visible_.bind(5);
  before_.bind(6);
  pages_.bind(13);
  for (const PageTable::Range& range : pages_.ranges()) {
    range.arena->slots.bind(4);
    cull_.set("first_entry", static_cast<GLuint>(range.first));
    gl::dispatchInvocations(range.count * SlotPage::kSlots);
  }
  gl::storageBarrier();
  visible_count_.forget();
  prefix_sum_.run(before_, words_, visible_count_, room_);
}

void Projection::project(const SlotStore& store, const rosplat_sorter::View& view,
                         const SplatCamera& camera, const MapState& map,
                         const RenderSettings& settings, double now, const gl::Buffer& keys) {
  // Rebased in double precision: neither the map's origin nor the camera's position reaches
  // float32.
  const auto& r = camera.rotation;
  std::array<float, 3> eye{};
  for (int i = 0; i < 3; ++i) {
    double position = 0;
    for (int k = 0; k < 3; ++k) {
      double t = camera.translation[k];
      for (int j = 0; j < 3; ++j) t += r[3 * k + j] * map.origin[j];
      position -= r[3 * k + i] * t;
    }
    eye[i] = static_cast<float>(camera.orthographic ? r[6 + i] : position);
  }
  const bool antialiased = settings.antialiasing == Antialiasing::kAsTrained
                               ? map.antialiased
                               : settings.antialiasing == Antialiasing::kOn;
  project_.use();
  setView(project_, view);
  glUniform3fv(project_.at("eye"), 1, eye.data());
  project_.set("focal", camera.fx, camera.fy);
  project_.set("principal_point", camera.cx, camera.cy);
  project_.set("picture", camera.width, camera.height);
  const SplatCamera::Whole whole = camera.whole();
  project_.set("whole_principal_point", whole.cx, whole.cy);
  project_.set("whole_picture", whole.width, whole.height);
  project_.set("sh_degree", std::min(store.shDegree(), settings.max_sh_degree));
  project_.set("only_band", settings.only_band);
  project_.set("antialiased", int(antialiased));
  project_.set("mode", static_cast<int>(settings.mode));
  project_.set("scale_modifier", settings.scale);
  project_.set("opacity_modifier", settings.opacity);
  project_.set("near_fade", settings.near_fade);
  project_.set("now", static_cast<float>(now));
  project_.set("age_range", settings.age_range);
  glUniform2i(project_.at("tiles"), tilesIn(camera.width), tilesIn(camera.height));
  project_.set("room", static_cast<GLuint>(room_));
  bindEllipses(project_);
  bindVisible();
  keys.bind(10);
  depth_range_.bind(11);
  boxes_.bind(12);
  pages_.bind(13);
  for (const PageTable::Range& range : pages_.ranges()) {
    range.arena->slots.bind(4);
    for (int band = 1; band <= kMaxShDegree; ++band) {
      // What isn't there isn't read, but something must be bound.
      (band <= store.shDegree() ? range.arena->bands[band] : range.arena->slots)
          .bind(static_cast<GLuint>(6 + band));
    }
    project_.set("first_entry", static_cast<GLuint>(range.first));
    gl::dispatchInvocations(range.count * SlotPage::kSlots);
  }
  gl::storageBarrier();
}

void Projection::bindEllipses(const gl::Program& program) const {
  for (std::size_t part = 0; part < ellipses_.size(); ++part) {
    (ellipses_[part].id() ? ellipses_[part] : ellipses_[0]).bind(static_cast<GLuint>(part));
  }
  program.set("part_size", static_cast<GLuint>(part_size_));
}

void Projection::bindVisible() const {
  visible_.bind(5);
  before_.bind(6);
}

std::size_t Projection::bytes() const {
  std::size_t bytes =
      pages_.bytes() + visible_.bytes() + before_.bytes() + boxes_.bytes() + prefix_sum_.bytes();
  for (const gl::Buffer& part : ellipses_) bytes += part.bytes();
  return bytes;
}

}  // namespace rosplat
