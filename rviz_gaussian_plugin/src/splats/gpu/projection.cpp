#include "gpu/projection.hpp"

#include <algorithm>
#include <initializer_list>

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

// Returns the program that projects. of: a file that says what for.
ShapedProgram projector(Shaders& shaders, std::initializer_list<const char*> of) {
  Shaders::Files files{"splat_map.glsl",   "splat_slot.glsl", "splat_groups.glsl",
                       "splat_pages.glsl", "splat_cut.glsl",  "splat_ellipses.glsl",
                       "splat_tiles.glsl"};
  files.insert(files.end(), of);
  files.push_back("splat_project.comp");
  return {shaders, files};
}

constexpr std::size_t kShareStep = gl::Slice::kAlignment / sizeof(GLuint);

}  // namespace

Projection::Projection(Shaders& shaders, const Tallies& tallies)
    : shaders_(shaders),
      project_(projector(shaders, {})),
      project_depths_(projector(shaders, {"splat_depths.glsl"})),
      seen_(tallies.of(Tallies::kSeen)) {}

void Projection::prepare(const Frame& frame, double growth) {
  std::vector<std::vector<SeenGroup>> groups;
  std::vector<GroupView> views;
  std::vector<MapBlock> maps;
  for (const FrameLayer& layer : frame.layers) {
    groups.push_back(
        seenGroups(layer.camera, layer.store.pages().groups(), layer.settings.clip_box));
    for (const SeenGroup& group : groups.back()) views.push_back(group.floats);
    maps.emplace_back(layer);
  }
  pages_.choose(frame, groups);
  groups_.upload(views);
  maps_.upload(maps);
  const Shapes shapes = frame.shapes();
  if (Shaders::ellipseBytes(shapes) != Shaders::ellipseBytes(shapes_) || used_.noteUse(slots())) {
    release();
  }
  shapes_ = shapes;
  if (slots() > room_ || room_ == 0 || frame.cuts() != hasShares()) {
    const std::size_t most = shaders_.mostEllipses(shapes_);
    if (slots() > most) {
      throw gl::Error("the graphics driver's buffers hold " + std::to_string(most) +
                      " projected splats, the pages in view have " + std::to_string(slots()));
    }
    // Room for what the next views may show, but no more than there is or will be.
    const double all = growth * static_cast<double>(pages_.all() * SlotPage::kSlots);
    const std::size_t roomy =
        std::min({withSlack(slots(), growth), static_cast<std::size_t>(all), most});
    reserve(std::max({room_, slots(), roomy, std::size_t{SlotPage::kSlots}}), frame.cuts());
  }
  if (frame.depths) planes_.reserve(room_ * 2 * sizeof(GLfloat));
}

void Projection::reserve(std::size_t slots, bool shares) {
  room_ = 0;  // stays so if memory is lacking
  const std::size_t part_size = shaders_.partSize(shapes_), bytes = Shaders::ellipseBytes(shapes_);
  for (std::size_t part = 0; part * part_size < slots; ++part) {
    ellipses_[part].reserve(std::min(part_size, slots - part * part_size) * bytes);
  }
  const std::size_t boxes = ceilDiv(slots, kShareStep) * kShareStep * sizeof(GLuint);
  shares_begin_ = shares ? boxes : 0;
  boxes_.reserve(boxes + shares_begin_);
  room_ = slots;
}

void Projection::release() {
  for (gl::Buffer& part : ellipses_) part.release();
  boxes_.release();
  planes_.release();
  shares_begin_ = room_ = 0;
}

void Projection::run(const Frame& frame, const gl::Buffer& keys) {
  constexpr std::array<GLuint, 6> kNothing{0, 0, ~0u, 0, ~0u, 0};  // a SeenTally
  seen_.write(kNothing.data(), sizeof(kNothing));
  const std::size_t layers = frame.layers.size();
  if (layers > 1) {
    if (of_layers_.bytes() != layers * sizeof(GLuint)) {
      of_layers_ = gl::Buffer(layers * sizeof(GLuint), GL_DYNAMIC_COPY);
      of_layers_copy_.emplace(layers);
      gl::settle();
    }
    of_layers_.zero();
  }
  const gl::Program& program = (frame.depths ? project_depths_ : project_).of(shapes_);
  program.use();
  program.set("first_share", static_cast<GLuint>(shares_begin_ / sizeof(GLuint)));
  program.set("one_layer", int(layers == 1));
  bindEllipses(program);
  program.bind("Keys", keys);
  program.bind("Seen", seen_);
  program.bind("OfLayers", layers > 1 ? gl::Slice{of_layers_.id(), 0, of_layers_.bytes()} : seen_);
  program.bind("Boxes", boxes_);
  program.bind("Planes", planes_);
  program.bind("Groups", groups_);
  program.bind("Pages", pages_.table());
  for (const PageTable::Range& range : pages_.ranges()) {
    const FrameLayer& layer = frame.layers[range.layer];
    glBindBufferRange(GL_UNIFORM_BUFFER, 1, maps_.id(),
                      static_cast<GLintptr>(range.layer * sizeof(MapBlock)), sizeof(MapBlock));
    program.bind("Slots", range.arena->slots);
    // Shaders don't read levels or bands that an arena lacks, but a buffer must be bound.
    program.bind("Levels", range.arena->levels.id() ? range.arena->levels : range.arena->slots);
    for (int band = 1; band <= kMaxShDegree; ++band) {
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
    program.set("layer", static_cast<GLuint>(range.layer));
    gl::dispatchInvocations(range.count * SlotPage::kSlots);
  }
  gl::storageBarrier();
  // So that ofLayers() doesn't wait for later work.
  if (layers > 1) of_layers_copy_->ask(of_layers_);
}

std::vector<std::size_t> Projection::ofLayers(std::size_t seen) const {
  const std::size_t layers = pages_.layerBegins().size() - 1;
  if (layers == 1) return {seen};
  const GLuint* const counts = of_layers_copy_->wait();
  return {counts, counts + layers};
}

void Projection::bindEllipses(const gl::Program& program) const {
  for (std::size_t part = 0; part < ellipses_.size(); ++part) {
    program.bind(kEllipses[part], ellipses_[part].id() ? ellipses_[part] : ellipses_[0]);
  }
}

std::size_t Projection::bytes() const {
  std::size_t bytes =
      pages_.bytes() + groups_.bytes() + maps_.bytes() + boxes_.bytes() + planes_.bytes();
  for (const gl::Buffer& part : ellipses_) bytes += part.bytes();
  return bytes;
}

}  // namespace rosplat
