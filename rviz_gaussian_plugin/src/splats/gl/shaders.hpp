#pragma once

#include <functional>
#include <initializer_list>
#include <map>
#include <string>
#include <vector>

#include "gl/gl_objects.hpp"

namespace rosplat {

// Tiles of splat_tiles.glsl that cover so many pixels.
constexpr int tilesIn(int pixels) { return (pixels + 15) / 16; }

// Reads a shader's source by file name.
using ShaderSource = std::function<std::string(const std::string& name)>;

// Compiles the programs of the renderer, each once, and has them for as long as it lives: each
// shader is put together from files, after what is common to all and what the driver is good for.
class Shaders {
 public:
  explicit Shaders(ShaderSource source);

  using Files = std::vector<const char*>;
  // The last file names the program. Throw gl::Error.
  const gl::Program& compute(const Files& files);
  // For work groups of LANES, of which WARP at most vote together: the driver's subgroups where it
  // says that it has some, else, or where they don't serve, what stands in for them.
  const gl::Program& computeInWarps(const Files& files, int lanes, bool in_subgroups);
  bool subgroups() const { return warp_ > 0; }
  // Whether work groups of a dispatch may wait for those before them; not known to until tried.
  bool groupsWait() const { return groups_wait_; }
  void giveUpWaiting() { groups_wait_ = false; }
  const gl::Program& draw(const Files& vertex, const Files& fragment);

  // Projected splats in one buffer of the driver's, and of the renderer's, at most kEllipseParts.
  std::size_t partSize() const { return part_size_; }

  static constexpr std::size_t kEllipseBytes = 32;  // as splat_common.glsl packs them
  static constexpr std::size_t kEllipseParts = 4;

 private:
  struct Stage {
    GLenum stage;
    std::string extensions;
    Files files;
  };
  const gl::Program& program(std::initializer_list<Stage> stages);
  std::string text(const Stage& stage) const;

  ShaderSource source_;
  std::map<std::string, gl::Program> programs_;  // by what they are made from
  std::size_t part_size_ = 0;
  std::size_t parts_ = 1;
  bool groups_wait_;
  int warp_ = 0;  // lanes of the driver's subgroups, at most; 0: it has none that serve
};

}  // namespace rosplat
