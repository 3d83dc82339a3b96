#include "splat_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rosplat {

namespace {

// A map grows by pages: nothing is ever copied or doubled, and an unused range costs nothing.
constexpr std::uint32_t kPageSlots = 1u << 16;
constexpr std::size_t kProjectedBytes = 3 * 4 * sizeof(float);
constexpr std::size_t kProjectedParts = 4;  // as in splat_quad.vert

void clearDepth() {
  const GLfloat farthest = 1.0f;
  glDepthMask(GL_TRUE);
  glClearBufferfv(GL_DEPTH, 0, &farthest);
}

// The opaque scene's depth at (x, y) of a framebuffer into the bound one, resolved to one sample a
// pixel. A framebuffer without depth hides nothing.
void copyDepth(GLuint source, GLint x, GLint y, const gl::Target& target) {
  glBindFramebuffer(GL_READ_FRAMEBUFFER, source);
  glBlitFramebuffer(x, y, x + target.width(), y + target.height(), 0, 0, target.width(),
                    target.height(), GL_DEPTH_BUFFER_BIT, GL_NEAREST);
}

std::size_t bandBytes(int band) { return kBandFloats[band] * sizeof(float); }

}  // namespace

SplatRenderer::SplatRenderer(const ShaderSource& source) {
  if (const std::string reason = gl::unsupported(); !reason.empty()) throw gl::Error(reason);
  const gl::StateGuard guard;
  const auto add = [&](gl::Program& program, GLenum stage, const char* name) {
    program.attach(stage, name, source(name));
  };
  add(project_, GL_COMPUTE_SHADER, "splat_project.comp");
  project_.link("splat_project");
  add(quads_, GL_VERTEX_SHADER, "splat_quad.vert");
  add(quads_, GL_FRAGMENT_SHADER, "splat_quad.frag");
  quads_.link("splat_quad");
  add(composite_, GL_VERTEX_SHADER, "splat_composite.vert");
  add(composite_, GL_FRAGMENT_SHADER, "splat_composite.frag");
  composite_.link("splat_composite");
  add(surface_, GL_VERTEX_SHADER, "splat_composite.vert");
  add(surface_, GL_FRAGMENT_SHADER, "splat_surface.frag");
  surface_.link("splat_surface");
  add(pick_, GL_COMPUTE_SHADER, "splat_pick.comp");
  pick_.link("splat_pick");
  add(pick_colour_, GL_VERTEX_SHADER, "splat_composite.vert");
  add(pick_colour_, GL_FRAGMENT_SHADER, "splat_pick.frag");
  pick_colour_.link("splat_pick_colour");

  GLint64 largest = 0;
  glGetInteger64v(GL_MAX_SHADER_STORAGE_BLOCK_SIZE, &largest);
  part_slots_ = static_cast<std::size_t>(largest) / kProjectedBytes / kPageSlots * kPageSlots;
  part_slots_ = std::min<std::size_t>(part_slots_, kMaxSlots);
}

SplatRenderer::Page& SplatRenderer::page(std::uint32_t index) {
  const auto found = pages_.find(index);
  if (found != pages_.end()) return found->second;
  Page fresh;
  fresh.geometry = gl::Buffer(kPageSlots * kGeometryFloats * sizeof(float), GL_DYNAMIC_DRAW);
  fresh.geometry.zero();  // opacity 0: an empty slot
  for (int band = 0; band <= sh_degree_; ++band) {
    fresh.bands[band] = gl::Buffer(kPageSlots * bandBytes(band), GL_DYNAMIC_DRAW);
    fresh.bands[band].zero();
  }
  return pages_.emplace(index, std::move(fresh)).first->second;
}

void SplatRenderer::addBands(int degree) {
  for (auto& [index, page] : pages_) {
    for (int band = sh_degree_ + 1; band <= degree; ++band) {
      page.bands[band] = gl::Buffer(kPageSlots * bandBytes(band), GL_DYNAMIC_DRAW);
      page.bands[band].zero();
    }
  }
  sh_degree_ = std::max(sh_degree_, degree);
}

void SplatRenderer::apply(const GaussianEdit& edit) {
  if (edit.clear) {
    pages_.clear();
    projected_.clear();
    sh_degree_ = 0;
    capacity_ = 0;
    order_count_ = 0;
  }
  addBands(edit.sh_degree);
  capacity_ = std::max(capacity_, edit.capacity);

  const float changed = age();
  std::vector<float> geometry, zeros;
  std::size_t source = 0;
  for (const auto& [run_first, run_count] : edit.runs) {
    std::uint32_t first = run_first, left = run_count;
    while (left > 0) {
      const std::uint32_t index = first / kPageSlots, offset = first % kPageSlots;
      const std::uint32_t count = std::min(left, kPageSlots - offset);
      if (edit.sh_degree >= 0 || pages_.count(index)) {
        Page& target = page(index);
        geometry.assign(edit.geometry.begin() + std::ptrdiff_t(kGeometryFloats * source),
                        edit.geometry.begin() + std::ptrdiff_t(kGeometryFloats * (source + count)));
        for (std::size_t i = 1; i <= count; ++i) geometry[kGeometryFloats * i - 1] = changed;
        target.geometry.write(offset * kGeometryFloats * sizeof(float), geometry.data(),
                              count * kGeometryFloats * sizeof(float));
        if (edit.sh_degree >= 0) {
          for (int band = 0; band <= sh_degree_; ++band) {
            const float* values = nullptr;
            if (band <= edit.sh_degree) {
              values = &edit.bands[band][kBandFloats[band] * source];
            } else {
              zeros.resize(std::max<std::size_t>(zeros.size(), kBandFloats[band] * count), 0.0f);
              values = zeros.data();
            }
            target.bands[band].write(offset * bandBytes(band), values, count * bandBytes(band));
          }
        }
      }
      first += count;
      left -= count;
      source += count;
    }
  }
}

void SplatRenderer::reserveProjected() {
  const std::size_t slots = (capacity_ + kPageSlots - 1) / kPageSlots * kPageSlots;
  std::size_t have = 0;
  for (const gl::Buffer& part : projected_) have += part.bytes() / kProjectedBytes;
  if (have >= slots) return;
  if (slots > kProjectedParts * part_slots_) {
    throw gl::Error("the graphics driver's buffers hold " +
                    std::to_string(kProjectedParts * part_slots_) + " splats, the map has " +
                    std::to_string(capacity_));
  }
  projected_.clear();  // written anew each frame: nothing to keep
  // Half as much again, so that a growing map seldom comes here.
  std::size_t want = std::min(slots + slots / 2, kProjectedParts * part_slots_);
  want = want / kPageSlots * kPageSlots;
  for (std::size_t first = 0; first < want; first += part_slots_) {
    projected_.emplace_back(std::min(part_slots_, want - first) * kProjectedBytes, GL_DYNAMIC_COPY);
    projected_.back().zero();
  }
}

void SplatRenderer::setOrder(const std::uint32_t* slots, std::size_t count) {
  const std::size_t bytes = count * sizeof(std::uint32_t);
  if (order_.bytes() < bytes) order_ = gl::Buffer(bytes + bytes / 2, GL_STREAM_DRAW);
  if (count > 0) order_.write(0, slots, bytes);
  order_count_ = count;
}

void SplatRenderer::project(const SplatCamera& camera, const MapState& map,
                            const RenderSettings& settings) {
  // Rebased in double precision: neither the map's origin nor the camera's position reaches
  // float32.
  const auto& r = camera.rotation;
  std::array<double, 3> t{};
  for (int i = 0; i < 3; ++i) {
    t[i] = camera.translation[i];
    for (int k = 0; k < 3; ++k) t[i] += r[3 * i + k] * map.origin[k];
  }
  std::array<float, 16> model_view{};  // column-major
  std::array<float, 3> eye{};
  for (int i = 0; i < 3; ++i) {
    double position = 0;
    for (int k = 0; k < 3; ++k) {
      model_view[4 * k + i] = static_cast<float>(r[3 * i + k]);
      position -= r[3 * k + i] * t[k];
    }
    model_view[12 + i] = static_cast<float>(t[i]);
    eye[i] = static_cast<float>(camera.orthographic ? r[6 + i] : position);
  }
  model_view[15] = 1.0f;

  if (!depth_range_.id()) depth_range_ = gl::Buffer(2 * sizeof(GLuint), GL_DYNAMIC_COPY);
  const std::array<GLuint, 2> no_range{0x7f800000u, 0u};  // infinity, zero
  depth_range_.write(0, no_range.data(), sizeof(no_range));

  const bool antialiased = settings.antialiasing == Antialiasing::kAsTrained
                               ? map.antialiased
                               : settings.antialiasing == Antialiasing::kOn;
  project_.use();
  glUniformMatrix4fv(project_.at("model_view"), 1, GL_FALSE, model_view.data());
  glUniform3fv(project_.at("eye"), 1, eye.data());
  glUniform1i(project_.at("orthographic"), camera.orthographic);
  glUniform2f(project_.at("focal"), float(camera.fx), float(camera.fy));
  glUniform2f(project_.at("principal_point"), float(camera.cx), float(camera.cy));
  glUniform2f(project_.at("picture"), float(camera.width), float(camera.height));
  glUniform2f(project_.at("clip"), float(camera.near_clip), float(camera.far_clip));
  glUniform2f(project_.at("ndc_depth"), float(camera.ndc_scale), float(camera.ndc_offset));
  glUniform1i(project_.at("sh_degree"), std::min(sh_degree_, settings.max_sh_degree));
  glUniform1i(project_.at("only_band"), std::min(settings.only_band, sh_degree_));
  glUniform1i(project_.at("antialiased"), antialiased);
  glUniform1i(project_.at("mode"), static_cast<GLint>(settings.mode));
  glUniform1f(project_.at("scale_modifier"), settings.scale);
  glUniform1f(project_.at("opacity_modifier"), settings.opacity);
  glUniform1f(project_.at("near_fade"), settings.near_fade);
  glUniform2f(project_.at("age"), age(), settings.age_range);
  const ClipBox& box = settings.clip_box;
  std::array<float, 3> box_centre{};
  for (int i = 0; i < 3; ++i) box_centre[i] = static_cast<float>(box.centre[i] - map.origin[i]);
  glUniform1i(project_.at("clip_to_box"), box.enabled);
  glUniform3fv(project_.at("box_centre"), 1, box_centre.data());
  glUniform3fv(project_.at("box_size"), 1, box.size.data());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 6, depth_range_.id());
  const GLint first_slot = project_.at("first_slot"), slot_count = project_.at("slot_count");
  for (const auto& [index, page] : pages_) {
    const std::size_t first = std::size_t{index} * kPageSlots;
    const std::size_t count = std::min<std::size_t>(kPageSlots, capacity_ - first);
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 0, page.geometry.id());
    for (int band = 0; band <= kMaxShDegree; ++band) {
      glBindBufferBase(GL_SHADER_STORAGE_BUFFER, static_cast<GLuint>(1 + band),
                       page.bands[std::min(band, sh_degree_)].id());
    }
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 5, projected_[first / part_slots_].id());
    glUniform1ui(first_slot, static_cast<GLuint>(first % part_slots_));
    glUniform1ui(slot_count, static_cast<GLuint>(count));
    glDispatchCompute(static_cast<GLuint>((count + 255) / 256), 1, 1);
  }
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT);
}

float SplatRenderer::age() const {
  return std::chrono::duration<float>(std::chrono::steady_clock::now() - start_).count();
}

void SplatRenderer::drawQuads(const gl::Target& target, const RenderSettings& settings,
                              bool raw_depth) const {
  glViewport(0, 0, target.width(), target.height());
  const std::array<float, 4> nothing{};
  glClearBufferfv(GL_COLOR, 0, nothing.data());
  if (order_count_ == 0 || projected_.empty()) return;
  glEnable(GL_BLEND);
  glBlendEquation(GL_FUNC_ADD);
  glBlendFunc(GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LEQUAL);
  glDepthMask(GL_FALSE);
  quads_.use();
  glUniform1ui(quads_.at("part_slots"), static_cast<GLuint>(part_slots_));
  glUniform1ui(quads_.at("capacity"), capacity_);
  glUniform2f(quads_.at("picture"), float(target.width()), float(target.height()));
  glUniform1f(quads_.at("up"), top_first_ ? -1.0f : 1.0f);
  glUniform1i(quads_.at("raw_depth"), raw_depth);
  glUniform1i(quads_.at("mode"), static_cast<GLint>(settings.mode));
  glUniform2fv(quads_.at("depth_range"), 1, settings.depth_range.data());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 5, depth_range_.id());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 0, order_.id());
  for (std::size_t part = 0; part < kProjectedParts; ++part) {
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, static_cast<GLuint>(1 + part),
                     projected_[std::min(part, projected_.size() - 1)].id());
  }
  glDrawArraysInstanced(GL_TRIANGLE_STRIP, 0, 4, static_cast<GLsizei>(order_count_));
}

void SplatRenderer::begin(const SplatCamera& camera, const MapState& map,
                          const RenderSettings& settings, Canvas canvas, gl::Target& target,
                          GLenum format) {
  if (target.width() != camera.width || target.height() != camera.height ||
      target.format() != format) {
    target = gl::Target(format, camera.width, camera.height);
  }
  top_first_ = canvas != Canvas::kWindow;
  reserveProjected();
  project(camera, map, settings);
  for (const GLenum off : {GL_ALPHA_TEST, GL_CULL_FACE, GL_SCISSOR_TEST, GL_STENCIL_TEST,
                           GL_SAMPLE_ALPHA_TO_COVERAGE, GL_FRAMEBUFFER_SRGB}) {
    glDisable(off);
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
}

void SplatRenderer::layOver(const gl::Program& program, GLuint framebuffer,
                            const gl::Target& target, GLint x, GLint y) const {
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, framebuffer);
  glViewport(x, y, target.width(), target.height());
  glDisable(GL_DEPTH_TEST);
  program.use();
  glUniform2i(program.at("corner"), x, y);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.color());
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

void SplatRenderer::draw(const SplatCamera& camera, const MapState& map,
                         const RenderSettings& settings, Canvas canvas) {
  const gl::StateGuard guard;
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  const GLint x = viewport[0], y = viewport[1];
  begin(camera, map, settings, canvas, color_, settings.float_blending ? GL_RGBA32F : GL_RGBA16F);
  drawn_settings_ = settings;

  const gl::DrawScope scope(color_);
  clearDepth();
  if (canvas != Canvas::kNone) copyDepth(guard.drawFramebuffer(), x, y, color_);
  drawQuads(color_, settings, false);
  if (canvas == Canvas::kNone) return;

  glEnable(GL_BLEND);
  glBlendEquation(GL_FUNC_ADD);
  glBlendFunc(GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
  layOver(composite_, guard.drawFramebuffer(), color_, x, y);
}

void SplatRenderer::drawSurface(const SplatCamera& camera, const MapState& map,
                                const RenderSettings& settings, Canvas canvas, double far_clip) {
  const gl::StateGuard guard;
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  const GLint x = viewport[0], y = viewport[1];
  begin(camera, map, settings, canvas, surface_depth_, GL_RGBA32F);
  const gl::DrawScope scope(surface_depth_);
  clearDepth();
  copyDepth(guard.drawFramebuffer(), x, y, surface_depth_);
  drawQuads(surface_depth_, settings, true);
  glDisable(GL_BLEND);
  surface_.use();
  glUniform1f(surface_.at("far_clip"), static_cast<float>(far_clip));
  layOver(surface_, guard.drawFramebuffer(), surface_depth_, x, y);
}

void SplatRenderer::drawPick(const SplatCamera& camera, const MapState& map,
                             const RenderSettings& settings, Canvas canvas, std::uint32_t handle) {
  const gl::StateGuard guard;
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  const GLint x = viewport[0], y = viewport[1];
  begin(camera, map, settings, canvas, pick_depth_, GL_RGBA16F);
  const gl::DrawScope scope(pick_depth_);
  clearDepth();
  if (canvas != Canvas::kNone) copyDepth(guard.drawFramebuffer(), x, y, pick_depth_);

  const int width = pick_depth_.width(), height = pick_depth_.height();
  const std::size_t bytes = sizeof(float) * std::size_t(width) * std::size_t(height);
  if (opaque_depths_.bytes() != bytes) {
    opaque_depths_ = gl::Buffer(bytes, GL_DYNAMIC_COPY);
    picked_ = gl::Buffer(bytes, GL_DYNAMIC_COPY);
  }
  glBindFramebuffer(GL_READ_FRAMEBUFFER, scope.framebuffer());
  glBindBuffer(GL_PIXEL_PACK_BUFFER, opaque_depths_.id());
  glReadPixels(0, 0, width, height, GL_DEPTH_COMPONENT, GL_FLOAT, nullptr);
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);

  pick_.use();
  glUniform1ui(pick_.at("count"), projected_.empty() ? 0u : static_cast<GLuint>(order_count_));
  glUniform1ui(pick_.at("part_slots"), static_cast<GLuint>(part_slots_));
  glUniform1ui(pick_.at("capacity"), capacity_);
  glUniform2i(pick_.at("picture"), width, height);
  glUniform1i(pick_.at("top_first"), top_first_);
  glUniform1i(pick_.at("mode"), static_cast<GLint>(settings.mode));
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 0, order_.id());
  for (std::size_t part = 0; part < kProjectedParts && !projected_.empty(); ++part) {
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, static_cast<GLuint>(1 + part),
                     projected_[std::min(part, projected_.size() - 1)].id());
  }
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 5, opaque_depths_.id());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 6, picked_.id());
  glDispatchCompute(static_cast<GLuint>((width + 15) / 16), static_cast<GLuint>((height + 15) / 16),
                    1);
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT | GL_BUFFER_UPDATE_BARRIER_BIT);
  if (canvas == Canvas::kNone) return;

  glDisable(GL_BLEND);
  pick_colour_.use();
  glUniform1i(pick_colour_.at("width"), width);
  glUniform1ui(pick_colour_.at("handle"), handle);
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 0, picked_.id());
  layOver(pick_colour_, guard.drawFramebuffer(), pick_depth_, x, y);
}

std::vector<std::uint32_t> SplatRenderer::readPick() const {
  const std::size_t columns = static_cast<std::size_t>(pick_depth_.width()),
                    rows = static_cast<std::size_t>(pick_depth_.height());
  std::vector<std::uint32_t> slots(columns * rows);
  for (std::size_t i = 0; i < rows; ++i) {
    const std::size_t target_row = top_first_ ? i : rows - 1 - i;
    picked_.read(target_row * columns * sizeof(std::uint32_t), &slots[i * columns],
                 columns * sizeof(std::uint32_t));
  }
  return slots;
}

std::vector<SplatValues> SplatRenderer::readSlots(const std::vector<std::uint32_t>& slots) const {
  std::vector<SplatValues> splats;
  for (const std::uint32_t slot : slots) {
    SplatValues& splat = splats.emplace_back();
    splat.slot = slot;
    const auto found = pages_.find(slot / kPageSlots);
    if (found == pages_.end()) continue;  // an empty slot
    const std::size_t offset = slot % kPageSlots;
    std::array<float, kGeometryFloats> g{};
    found->second.geometry.read(offset * sizeof(g), g.data(), sizeof(g));
    splat.position = {g[0], g[1], g[2]};
    splat.opacity = g[3];
    splat.orientation = {g[4], g[5], g[6], g[7]};
    splat.scale = {g[8], g[9], g[10]};
    for (int band = 0; band <= sh_degree_; ++band) {
      const std::size_t have = splat.sh.size();
      splat.sh.resize(have + std::size_t(kBandFloats[band]));
      found->second.bands[band].read(offset * bandBytes(band), &splat.sh[have], bandBytes(band));
    }
  }
  return splats;
}

std::vector<float> SplatRenderer::readColor() const {
  const std::size_t row = 4 * static_cast<std::size_t>(color_.width());
  std::vector<float> pixels(row * static_cast<std::size_t>(color_.height()));
  const gl::StateGuard guard;
  const gl::DrawScope scope(color_);
  glReadPixels(0, 0, color_.width(), color_.height(), GL_RGBA, GL_FLOAT, pixels.data());
  if (!top_first_) {
    for (std::size_t top = 0, bottom = pixels.size() - row; top < bottom;
         top += row, bottom -= row) {
      std::swap_ranges(&pixels[top], &pixels[top] + row, &pixels[bottom]);
    }
  }
  return pixels;
}

std::vector<float> SplatRenderer::readDepth() {
  const gl::StateGuard guard;
  if (depth_.width() != color_.width() || depth_.height() != color_.height()) {
    depth_ = gl::Target(GL_RGBA32F, color_.width(), color_.height());
  }
  const int width = depth_.width(), height = depth_.height();
  glDisable(GL_ALPHA_TEST);
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_CULL_FACE);
  const gl::DrawScope color(color_);
  const gl::DrawScope scope(depth_);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, color.framebuffer());
  glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, GL_DEPTH_BUFFER_BIT, GL_NEAREST);
  drawQuads(depth_, drawn_settings_, true);
  const std::size_t columns = static_cast<std::size_t>(width),
                    rows = static_cast<std::size_t>(height);
  std::vector<float> blended(4 * columns * rows), depths(columns * rows);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, scope.framebuffer());
  glReadPixels(0, 0, width, height, GL_RGBA, GL_FLOAT, blended.data());
  for (std::size_t row = 0; row < rows; ++row) {
    const float* source = &blended[4 * columns * (top_first_ ? row : rows - 1 - row)];
    for (std::size_t column = 0; column < columns; ++column, source += 4) {
      depths[columns * row + column] =
          source[3] > 0.0f ? source[0] / source[3] : std::numeric_limits<float>::quiet_NaN();
    }
  }
  return depths;
}

std::size_t SplatRenderer::gpuBytes() const {
  std::size_t bytes = order_.bytes() + color_.bytes() + depth_.bytes() + surface_depth_.bytes() +
                      pick_depth_.bytes() + opaque_depths_.bytes() + picked_.bytes();
  for (const gl::Buffer& part : projected_) bytes += part.bytes();
  for (const auto& [index, page] : pages_) {
    bytes += page.geometry.bytes();
    for (const gl::Buffer& band : page.bands) bytes += band.bytes();
  }
  return bytes;
}

}  // namespace rosplat
