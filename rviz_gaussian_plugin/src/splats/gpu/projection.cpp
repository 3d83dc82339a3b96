#include "gpu/projection.hpp"

#include <algorithm>

#include "map/seen_group.hpp"

namespace rosplat {

namespace {

// Storage blocks of the shaders.
constexpr std::array<const char*, kMaxShDegree + 1> kBands{"", "Band1", "Band2", "Band3"};
constexpr std::array<const char*, Shaders::kEllipseParts> kEllipses{"Ellipses[0]", "Ellipses[1]",
                                                                    "Ellipses[2]", "Ellipses[3]"};

constexpr std::size_t kShareStep = gl::Slice::kAlignment / sizeof(GLuint);

// What isn't there isn't read, but something must be bound.
void bindLevels(const gl::Program& program, const SlotArenas::Arena& arena) {
  program.bind("Levels", arena.levels.id() ? arena.levels : arena.slots);
}

}  // namespace

Projection::Projection(Shaders& shaders, const Tallies& tallies)
    : cull_(shaders.compute({"splat_slot.glsl", "splat_groups.glsl", "splat_pages.glsl",
                             "splat_cut.glsl", "splat_visible.glsl", "splat_cull.comp"})),
      project_(shaders.compute({"splat_slot.glsl", "splat_groups.glsl", "splat_pages.glsl",
                                "splat_cut.glsl", "splat_visible.glsl", "splat_ellipses.glsl",
                                "splat_tiles.glsl", "splat_project.comp"})),
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

void Projection::run(const Frame& frame, const gl::Buffer& keys) {
  const std::array<GLuint, Tally::kBytes / sizeof(GLuint)> no_range{~0u};
  depth_range_.write(no_range.data());
  const std::vector<SeenGroup> groups =
      seenGroups(frame.camera, frame.store.pages().groups(), frame.settings.clip_box);
  pages_.keep(frame, groups);
  if (pages_.count() == 0) {
    visible_count_.set(0);
    return;
  }
  std::vector<GroupView> views;
  for (const SeenGroup& group : groups) views.push_back(group.floats);
  groups_.upload(views);
  cull();
  glFlush();  // the graphics card begins while the rest is submitted
  project(frame, keys);
}

void Projection::cull() {
  const std::size_t words = slotWords();
  visible_.reserve(words * sizeof(GLuint));
  before_.reserve(words * sizeof(GLuint));
  prefix_sum_.reserve(words);
  words_.set(words);
  cull_.use();
  bindVisible(cull_);
  cull_.bind("Groups", groups_);
  cull_.bind("Pages", pages_.table());
  for (const PageTable::Range& range : pages_.ranges()) {
    cull_.bind("Slots", range.arena->slots);
    bindLevels(cull_, *range.arena);
    cull_.set("first_entry", static_cast<GLuint>(range.first));
    gl::dispatchInvocations(range.count * SlotPage::kSlots);
  }
  gl::storageBarrier();
  visible_count_.forget();
  prefix_sum_.run(before_, words_, visible_count_, room_);
}

void Projection::project(const Frame& frame, const gl::Buffer& keys) {
  const std::size_t first_share = (room_ + kShareStep - 1) / kShareStep * kShareStep;
  shares_begin_ = frame.cuts() ? first_share * sizeof(GLuint) : 0;
  boxes_.reserve(shares_begin_ + first_share * sizeof(GLuint));
  project_.use();
  project_.set("room", static_cast<GLuint>(room_));
  project_.set("first_share", static_cast<GLuint>(first_share));
  bindEllipses(project_);
  bindVisible(project_);
  project_.bind("Keys", keys);
  project_.bind("DepthRange", depth_range_);
  project_.bind("Boxes", boxes_);
  project_.bind("Groups", groups_);
  project_.bind("Pages", pages_.table());
  const RenderSettings& settings = frame.settings;
  const std::size_t channel = settings.mode == DrawMode::kChannel
                                  ? colouringOf(frame.map.channels, settings).channel
                                  : kMostChannels;
  for (const PageTable::Range& range : pages_.ranges()) {
    project_.bind("Slots", range.arena->slots);
    bindLevels(project_, *range.arena);
    for (int band = 1; band <= kMaxShDegree; ++band) {
      // What isn't there isn't read, but something must be bound.
      project_.bind(kBands[band],
                    band <= frame.store.shDegree() ? range.arena->bands[band] : range.arena->slots);
    }
    if (channel < frame.store.channels()) {
      project_.bind(kBands[1], range.arena->channels[channel]);
    }
    project_.set("first_entry", static_cast<GLuint>(range.first));
    gl::dispatchInvocations(range.count * SlotPage::kSlots);
  }
  gl::storageBarrier();
}

void Projection::bindEllipses(const gl::Program& program) const {
  for (std::size_t part = 0; part < ellipses_.size(); ++part) {
    program.bind(kEllipses[part], ellipses_[part].id() ? ellipses_[part] : ellipses_[0]);
  }
}

void Projection::bindVisible(const gl::Program& program) const {
  program.bind("Visible", visible_);
  program.bind("Before", before_);
}

std::size_t Projection::bytes() const {
  std::size_t bytes = pages_.bytes() + groups_.bytes() + visible_.bytes() + before_.bytes() +
                      boxes_.bytes() + prefix_sum_.bytes();
  for (const gl::Buffer& part : ellipses_) bytes += part.bytes();
  return bytes;
}

}  // namespace rosplat
