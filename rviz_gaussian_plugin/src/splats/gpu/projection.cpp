#include "gpu/projection.hpp"

#include <algorithm>

#include "gl/driver.hpp"
#include "gpu/view_block.hpp"
#include "rosplat_core/views/channel_colouring.hpp"
#include "rosplat_core/views/seen_group.hpp"

namespace rosplat {

namespace {

// Storage blocks of the shaders.
constexpr std::array<const char*, kMaxShDegree + 1> kBands{"", "Band1", "Band2", "Band3"};
constexpr std::array<const char*, Shaders::kEllipseParts> kEllipses{"Ellipses[0]", "Ellipses[1]",
                                                                    "Ellipses[2]", "Ellipses[3]"};

constexpr std::size_t kGroupWords = 8;  // of 256 slots, which are counted together
constexpr std::size_t kShareStep = gl::Slice::kAlignment / sizeof(GLuint);

// Shaders don't read levels that an arena lacks, but a buffer must be bound.
void bindLevels(const gl::Program& program, const SlotArenas::Arena& arena) {
  program.bind("Levels", arena.levels.id() ? arena.levels : arena.slots);
}

}  // namespace

Projection::Projection(Shaders& shaders, const Tallies& tallies)
    : shaders_(shaders),
      cull_(shaders.compute({"splat_map.glsl", "splat_slot.glsl", "splat_groups.glsl",
                             "splat_pages.glsl", "splat_cut.glsl", "splat_visible.glsl",
                             "splat_counts.glsl", "splat_cull.comp"})),
      project_(shaders,
               {"splat_map.glsl", "splat_slot.glsl", "splat_groups.glsl", "splat_pages.glsl",
                "splat_cut.glsl", "splat_visible.glsl", "splat_counts.glsl", "splat_ellipses.glsl",
                "splat_tiles.glsl", "splat_project.comp"}),
      seen_(tallies.of(Tallies::kSeen)) {}

void Projection::prepare(Shapes shapes) {
  if (Shaders::ellipseBytes(shapes) != Shaders::ellipseBytes(shapes_)) release();
  shapes_ = shapes;
}

void Projection::reserve(std::size_t count) {
  if (count <= room_) return;
  if (const std::size_t most = shaders_.mostEllipses(shapes_); count > most) {
    throw gl::Error("the graphics driver's buffers hold " + std::to_string(most) +
                    " visible splats, this view has " + std::to_string(count));
  }
  room_ = 0;  // stays so if memory is lacking
  const std::size_t part_size = shaders_.partSize(shapes_), bytes = Shaders::ellipseBytes(shapes_);
  for (std::size_t part = 0; part * part_size < count; ++part) {
    ellipses_[part].reserve(std::min(part_size, count - part * part_size) * bytes);
  }
  boxes_.reserve(count * sizeof(GLuint));
  room_ = count;
}

void Projection::release() {
  for (gl::Buffer& part : ellipses_) part.release();
  boxes_.release();
  visible_.release();
  shares_begin_ = room_ = 0;
}

void Projection::run(const Frame& frame, const gl::Buffer& keys) {
  std::vector<std::vector<SeenGroup>> groups;
  std::vector<GroupView> views;
  std::vector<MapBlock> maps;
  for (const FrameLayer& layer : frame.layers) {
    groups.push_back(
        seenGroups(layer.camera, layer.store.pages().groups(), layer.settings.clip_box));
    for (const SeenGroup& group : groups.back()) views.push_back(group.floats);
    maps.emplace_back(layer);
  }
  pages_.keep(frame, groups);
  if (pages_.count() == 0) {
    constexpr std::array<GLuint, 6> kNothing{0, 0, ~0u, 0, ~0u, 0};
    return seen_.write(kNothing.data(), sizeof(kNothing));
  }
  const std::size_t boxes = ceilDiv(room_, kShareStep) * kShareStep * sizeof(GLuint);
  shares_begin_ = frame.cuts() ? boxes : 0;
  boxes_.reserve(boxes + shares_begin_);
  groups_.upload(views);
  maps_.upload(maps);
  cull();
  glFlush();  // the graphics card begins while the rest is submitted
  project(frame, keys);
  if (frame.layers.size() > 1) askForLayers();
}

void Projection::cull() {
  visible_.reserve(2 * slotWords() * sizeof(GLuint), slotWords());
  counts_.begin(slotWords() / kGroupWords);
  cull_.use();
  counts_.bind(cull_);
  bindVisible(cull_);
  cull_.bind("Seen", seen_);
  cull_.bind("Groups", groups_);
  cull_.bind("Pages", pages_.table());
  for (const PageTable::Range& range : pages_.ranges()) {
    bindMap(range);
    cull_.bind("Slots", range.arena->slots);
    bindLevels(cull_, *range.arena);
    cull_.set("first_entry", static_cast<GLuint>(range.first));
    gl::dispatchInvocations(range.count * SlotPage::kSlots);
  }
  gl::storageBarrier();
}

// Copies the counts as soon as they are known, so that visibleOf() doesn't wait for later work.
void Projection::askForLayers() {
  const std::vector<std::size_t>& begins = pages_.layerBegins();
  const std::size_t layers = begins.size() - 1;
  if (visible_before_.bytes() != layers * sizeof(GLuint)) {
    visible_before_ = gl::Buffer(layers * sizeof(GLuint), GL_DYNAMIC_COPY);
    visible_before_copy_.emplace(layers);
    gl::settle();
  }
  constexpr std::size_t kPageWords = SlotPage::kSlots / 32;
  for (std::size_t layer = 0; layer < layers && begins[layer] < begins.back(); ++layer) {
    visible_before_.copy(visible_, (2 * begins[layer] * kPageWords + 1) * sizeof(GLuint),
                         sizeof(GLuint), layer * sizeof(GLuint));
  }
  visible_before_copy_->ask(visible_before_);
}

std::vector<std::size_t> Projection::visibleOf(std::size_t visible) const {
  const std::vector<std::size_t>& begins = pages_.layerBegins();
  std::vector<std::size_t> counts(begins.size() - 1);
  const bool several = counts.size() > 1 && pages_.count() > 0;
  const GLuint* const before = several ? visible_before_copy_->wait() : nullptr;
  // From the last layer, which ends with the last visible splat.
  for (std::size_t layer = counts.size(), end = visible; layer-- > 0;) {
    const bool any = begins[layer] < begins.back();
    const std::size_t begin = !any ? end : several ? before[layer] : 0;
    counts[layer] = end - begin;
    end = begin;
  }
  return counts;
}

void Projection::bindMap(const PageTable::Range& range) const {
  glBindBufferRange(GL_UNIFORM_BUFFER, 1, maps_.id(),
                    static_cast<GLintptr>(range.layer * sizeof(MapBlock)), sizeof(MapBlock));
}

void Projection::project(const Frame& frame, const gl::Buffer& keys) {
  const gl::Program& program = project_.of(shapes_);
  program.use();
  program.set("room", static_cast<GLuint>(room_));
  program.set("first_share", static_cast<GLuint>(shares_begin_ / sizeof(GLuint)));
  bindEllipses(program);
  bindVisible(program);
  counts_.bind(program);
  program.set("groups_of_slots", static_cast<GLuint>(slotWords() / kGroupWords));
  program.bind("Keys", keys);
  program.bind("Seen", seen_);
  program.bind("Boxes", boxes_);
  program.bind("Groups", groups_);
  program.bind("Pages", pages_.table());
  for (const PageTable::Range& range : pages_.ranges()) {
    const FrameLayer& layer = frame.layers[range.layer];
    bindMap(range);
    program.bind("Slots", range.arena->slots);
    bindLevels(program, *range.arena);
    for (int band = 1; band <= kMaxShDegree; ++band) {
      // Shaders don't read bands that the map lacks, but a buffer must be bound.
      program.bind(kBands[band],
                   band <= layer.store.shDegree() ? range.arena->bands[band] : range.arena->slots);
    }
    if (layer.settings.mode == DrawMode::kChannel) {
      const std::size_t channel = colouringOf(layer.map.channels, layer.settings).channel;
      if (channel < layer.store.channels()) {
        program.bind(kBands[1], range.arena->channels[channel]);
      }
    }
    program.set("first_entry", static_cast<GLuint>(range.first));
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
}

std::size_t Projection::bytes() const {
  std::size_t bytes = pages_.bytes() + groups_.bytes() + maps_.bytes() + visible_.bytes() +
                      counts_.bytes() + boxes_.bytes();
  for (const gl::Buffer& part : ellipses_) bytes += part.bytes();
  return bytes;
}

}  // namespace rosplat
