#include "gpu/half_picture.hpp"

#include <initializer_list>
#include <utility>

namespace rosplat {

namespace {

void bindTextures(std::initializer_list<GLuint> textures) {
  GLenum unit = GL_TEXTURE0 + static_cast<GLenum>(textures.size());
  for (auto texture = textures.end(); texture != textures.begin();) {
    glActiveTexture(--unit);
    glBindTexture(GL_TEXTURE_2D, *--texture);
  }
}

}  // namespace

HalfPicture::HalfPicture(const Shaders& shaders)
    : shrink_(shaders.draw({"splat_composite.vert"}, {"splat_shrink.frag"})),
      enlarge_(shaders.draw({"splat_composite.vert"}, {"splat_enlarge.frag"})) {}

void HalfPicture::shrink(const gl::Target& full, const gl::Target* behind, bool top_first) {
  shrink(full, target_, 0, top_first);
  if (behind) shrink(*behind, behind_, GL_RG32F, top_first);
}

void HalfPicture::shrink(const gl::Target& full, gl::Target& half, GLenum second_format,
                         bool top_first) const {
  const int width = (full.width() + 1) / 2, height = (full.height() + 1) / 2;
  if (half.become(full.format(), width, height, full.depthFormat(), second_format)) {
    for (const GLuint texture : {half.color(), half.second()}) {
      bindTextures({texture});
      glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
      glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
      glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
    }
  }
  const gl::DrawScope scope(half);
  glViewport(0, 0, width, height);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_ALWAYS);
  glDepthMask(GL_TRUE);
  shrink_.use();
  shrink_.set("rows", height);
  shrink_.set("top_first", int(top_first));
  bindTextures({full.depth()});
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

void HalfPicture::enlarge(const gl::Target& full, const gl::Target* behind, bool top_first) const {
  const gl::Target no_depth;  // which is read
  glDisable(GL_BLEND);
  glDisable(GL_DEPTH_TEST);
  glViewport(0, 0, full.width(), full.height());
  enlarge_.use();
  enlarge_.set("top_first", int(top_first));
  for (const auto& [half, whole] : {std::pair{&target_, &full}, std::pair{&behind_, behind}}) {
    if (!whole) continue;
    const gl::DrawScope scope(*whole, no_depth);
    // What is behind ends at both depths.
    const bool both = behind && whole == behind;
    bindTextures({half->color(), half->second(), target_.depth(), full.depth(),
                  both ? behind_.depth() : target_.depth(), both ? behind->depth() : full.depth()});
    glDrawArrays(GL_TRIANGLES, 0, 3);
  }
}

SplatCamera halved(const SplatCamera& camera) {
  SplatCamera half = camera;
  half.width = (camera.width + 1) / 2;
  half.height = (camera.height + 1) / 2;
  half.fx /= 2;
  half.fy /= 2;
  half.cx /= 2;
  half.cy /= 2;
  const SplatCamera::Whole whole = camera.whole();  // where an odd pixel isn't widened
  half.part_of = {whole.cx / 2, whole.cy / 2, whole.width / 2, whole.height / 2};
  return half;
}

}  // namespace rosplat
