#pragma once

#include <cstddef>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "map/splat_camera.hpp"

namespace rosplat {

// Targets of half as many pixels each way, to be drawn into instead of others: a quarter of the
// work, and what comes out is laid into those, within the edges that their depths have.
class HalfPicture {
 public:
  explicit HalfPicture(const Shaders& shaders);

  // Takes over the depths of a target and, if there is one, of what is behind what divides it.
  void shrink(const gl::Target& full, const gl::Target* behind, bool top_first);
  const gl::Target& target() const { return target_; }
  const gl::Target& behind() const { return behind_; }
  // Overwrites the colours of these.
  void enlarge(const gl::Target& full, const gl::Target* behind, bool top_first) const;

  std::size_t bytes() const { return target_.bytes() + behind_.bytes(); }

 private:
  void shrink(const gl::Target& full, gl::Target& half, GLenum second_format, bool top_first) const;

  gl::Program shrink_, enlarge_;
  gl::Target target_, behind_;
};

// The camera of a HalfPicture of a camera's.
SplatCamera halved(const SplatCamera& camera);

}  // namespace rosplat
