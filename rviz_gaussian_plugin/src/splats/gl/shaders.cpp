#include "gl/shaders.hpp"

#include <algorithm>

#include "map/gaussian_map.hpp"

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

Shaders::Shaders(ShaderSource source) : source_(std::move(source)), warp_(subgroupSize()) {
  part_size_ = std::min<std::size_t>(gl::largestStorageBuffer() / kEllipseBytes, kMaxSlots);
  parts_ = part_size_ >= kMaxSlots ? 1 : kEllipseParts;
}

void Shaders::attach(gl::Program& program, GLenum stage, const std::string& extensions,
                     Files files) const {
  std::string text = "#version 430\n" + extensions;
  text += "#define PARTS " + std::to_string(parts_) + "\n";
  if (stage == GL_COMPUTE_SHADER) text += "#define COMPUTE\n";
  text += source_("splat_common.glsl");
  for (const char* file : files) text += "\n#line 1\n" + source_(file);
  program.attach(stage, *(files.end() - 1), text);
}

gl::Program Shaders::compute(Files files) const { return compute("", files); }

gl::Program Shaders::computeInWarps(Files files, bool in_subgroups) const {
  const int warp = in_subgroups ? warp_ : kEmulatedWarp;
  const std::string size = "#define WARP " + std::to_string(warp) + "\n";
  return compute((in_subgroups ? kSubgroups : "") + size, files);
}

gl::Program Shaders::compute(const std::string& extensions, Files files) const {
  gl::Program program;
  attach(program, GL_COMPUTE_SHADER, extensions, files);
  program.link(*(files.end() - 1));
  return program;
}

gl::Program Shaders::draw(Files vertex, Files fragment) const {
  gl::Program program;
  attach(program, GL_VERTEX_SHADER, "", vertex);
  attach(program, GL_FRAGMENT_SHADER, "", fragment);
  program.link(*(fragment.end() - 1));
  return program;
}

}  // namespace rosplat
