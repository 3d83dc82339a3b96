#pragma once

#include <array>
#include <functional>
#include <initializer_list>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "gl/program.hpp"

namespace rosplat {

// Tiles of splat_tiles.glsl that cover so many pixels.
constexpr int tilesIn(int pixels) { return (pixels + 15) / 16; }

// Reads a shader's source by file name.
using ShaderSource = std::function<std::string(const std::string& name)>;

// The engine's constants that shaders use, in GLSL: constants.cpp.
std::string constantsInGlsl();

// What splats are drawn as. Programs of each know those before it, too, and cost more than those.
enum class Shapes {
  kEllipses,  // in the picture: Model::kEwa, kEwaAntialiased
  kRays,      // responses along rays: kRay
  kDiscs,     // with a spot each: kDisc
};

// Compiles the programs of the renderer, each once, and owns them. A shader begins with defines for
// the driver and the text that all shaders share; its own files follow.
class Shaders {
 public:
  explicit Shaders(ShaderSource source);

  using Files = std::vector<const char*>;
  // The last file names the program. All that compile throw gl::Error.
  const gl::Program& compute(const Files& files, Shapes shapes = Shapes::kEllipses);
  // For work groups of LANES invocations, of which at most WARP vote together. in_subgroups: in the
  // driver's subgroups (needs subgroups()); else the shader emulates them.
  const gl::Program& computeInWarps(const Files& files, int lanes, bool in_subgroups);
  bool subgroups() const { return warp_ > 0; }
  // Whether work groups of a dispatch may wait for earlier ones. A guess until RadixSort::check().
  bool groupsWait() const { return groups_wait_; }
  void giveUpWaiting() { groups_wait_ = false; }
  const gl::Program& draw(const Files& vertex, const Files& fragment);

  // How many projected splats fit in one buffer. The renderer has at most kEllipseParts of these.
  std::size_t partSize(Shapes shapes) const { return part_bytes_ / ellipseBytes(shapes); }
  std::size_t mostEllipses(Shapes shapes) const { return parts_ * partSize(shapes); }

  // Of a projected splat, as splat_common.glsl packs it.
  static constexpr std::size_t ellipseBytes(Shapes shapes) {
    return shapes == Shapes::kEllipses ? 32 : 48;
  }
  static constexpr std::size_t kEllipseParts = 4;

 private:
  struct Stage {
    GLenum stage;
    std::string extensions;
    Files files;
    Shapes shapes = Shapes::kEllipses;
  };
  const gl::Program& program(std::initializer_list<Stage> stages);
  std::string text(const Stage& stage) const;

  ShaderSource source_;
  std::map<std::string, gl::Program> programs_;  // by extensions, files and shapes
  std::size_t part_bytes_ = 0;
  std::size_t parts_ = 1;
  bool groups_wait_;
  int warp_ = 0;  // most lanes of the driver's subgroups; 0: the driver has no usable ones
};

// A program for each of the Shapes: that of ellipses compiled at once, others when they are needed.
class ShapedProgram {
 public:
  ShapedProgram(Shaders& shaders, Shaders::Files files)
      : shaders_(shaders), files_(std::move(files)) {
    of(Shapes::kEllipses);
  }

  const gl::Program& of(Shapes shapes) const {
    const gl::Program*& program = programs_[static_cast<std::size_t>(shapes)];
    if (!program) program = &shaders_.compute(files_, shapes);
    return *program;
  }

 private:
  Shaders& shaders_;
  Shaders::Files files_;
  mutable std::array<const gl::Program*, 3> programs_{};
};

}  // namespace rosplat
