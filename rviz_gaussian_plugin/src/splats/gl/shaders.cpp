#include "gl/shaders.hpp"

#include <algorithm>
#include <limits>

#include "gl/buffer.hpp"
#include "gl/driver.hpp"
#include "rosplat_core/map/gaussian_map.hpp"

namespace rosplat {

namespace {

constexpr const char* kSubgroups =
    "#extension GL_KHR_shader_subgroup_basic : require\n"
    "#extension GL_KHR_shader_subgroup_ballot : require\n"
    "#extension GL_KHR_shader_subgroup_shuffle : require\n#define SUBGROUPS\n";
constexpr int kEmulatedWarp = 32;

int subgroupSize() {
  if (!epoxy_has_gl_extension("GL_KHR_shader_subgroup")) return 0;
  constexpr GLint kNeeded =
      GL_SUBGROUP_FEATURE_BALLOT_BIT_KHR | GL_SUBGROUP_FEATURE_SHUFFLE_BIT_KHR;
  GLint size = 0, features = 0, stages = 0;
  glGetIntegerv(GL_SUBGROUP_SIZE_KHR, &size);
  glGetIntegerv(GL_SUBGROUP_SUPPORTED_FEATURES_KHR, &features);
  glGetIntegerv(GL_SUBGROUP_SUPPORTED_STAGES_KHR, &stages);
  const bool serve = (features & kNeeded) == kNeeded && (stages & GL_COMPUTE_SHADER_BIT);
  return serve && size >= 8 && size <= 64 ? size : 0;
}

}  // namespace

Shaders::Shaders(ShaderSource source)
    : source_(std::move(source)), groups_wait_(gl::accelerated()), warp_(subgroupSize()) {
  constexpr std::size_t kMost = std::numeric_limits<GLuint>::max();
  part_bytes_ = std::min(gl::largestStorageBuffer(), kMost);
  parts_ = partSize(Shapes::kDiscs) >= kMaxSlots ? 1 : kEllipseParts;
}

std::string Shaders::text(const Stage& stage) const {
  std::string text = "#version 430\n" + stage.extensions;
  text += "#define PARTS " + std::to_string(parts_) + "\n";
  text += "#define PART_BYTES " + std::to_string(part_bytes_) + "u\n";
  if (stage.stage == GL_COMPUTE_SHADER) text += "#define COMPUTE\n";
  if (stage.shapes >= Shapes::kRays) text += "#define RAYS\n";
  if (stage.shapes >= Shapes::kDiscs) text += "#define DISCS\n";
  text += constantsInGlsl() + source_("splat_common.glsl") + source_("splat_view.glsl");
  if (stage.shapes > Shapes::kEllipses) text += source_("splat_conic.glsl");
  for (const char* file : stage.files) text += "\n#line 1\n" + source_(file);
  return text;
}

const gl::Program& Shaders::program(std::initializer_list<Stage> stages) {
  std::string key;
  for (const Stage& stage : stages) {
    key += stage.extensions + std::to_string(static_cast<int>(stage.shapes)) + " ";
    for (const char* file : stage.files) key += std::string(file) + " ";
  }
  if (const auto found = programs_.find(key); found != programs_.end()) return found->second;
  gl::Program program;
  const char* name = "";
  for (const Stage& stage : stages) {
    name = stage.files.back();
    program.attach(stage.stage, name, text(stage));
  }
  program.link(name);
  return programs_.emplace(std::move(key), std::move(program)).first->second;
}

const gl::Program& Shaders::compute(const Files& files, Shapes shapes) {
  return program({{GL_COMPUTE_SHADER, "", files, shapes}});
}

const gl::Program& Shaders::computeInWarps(const Files& files, int lanes, bool in_subgroups) {
  const int warp = in_subgroups ? warp_ : kEmulatedWarp;
  const std::string size =
      "#define WARP " + std::to_string(warp) + "\n#define LANES " + std::to_string(lanes) + "\n";
  return program({{GL_COMPUTE_SHADER, (in_subgroups ? kSubgroups : "") + size, files}});
}

const gl::Program& Shaders::draw(const Files& vertex, const Files& fragment) {
  return program({{GL_VERTEX_SHADER, "", vertex}, {GL_FRAGMENT_SHADER, "", fragment}});
}

}  // namespace rosplat
