#include "tile_rasterizer.hpp"

#include <algorithm>

namespace rosplat {

namespace {

constexpr int kTile = 16;  // as in splat_tiles.glsl
constexpr std::size_t kGroup = 256;
constexpr std::size_t kMostListed = std::size_t{1} << 26;  // 1 GiB with what sorts them

std::size_t groups(std::size_t count) { return (count + kGroup - 1) / kGroup; }

int bitsOf(std::size_t value) {
  int bits = 0;
  while (value >> bits) ++bits;
  return bits;
}

}  // namespace

void Raster::set(const gl::Program& program) const {
  program.set("orthographic", int(orthographic));
  program.set("ndc_depth", ndc_scale, ndc_offset);
  program.set("mode", static_cast<int>(mode));
  glUniform2fv(program.at("depth_range"), 1, depth_range.data());
}

TileRasterizer::TileRasterizer(const Shaders& shaders, RadixSort& sort)
    : count_(shaders.compute({"splat_ellipses.glsl", "splat_tiles.glsl", "tile_count.comp"})),
      list_(shaders.compute({"splat_ellipses.glsl", "splat_tiles.glsl", "tile_list.comp"})),
      ranges_(shaders.compute({"tile_ranges.comp"})),
      blend_(shaders.compute(
          {"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl", "tile_blend.comp"})),
      prefix_sum_(shaders),
      sort_(sort) {
  GLint64 largest = 0;
  glGetInteger64v(GL_MAX_SHADER_STORAGE_BLOCK_SIZE, &largest);
  most_listed_ = std::min(kMostListed, static_cast<std::size_t>(largest) / sizeof(GLuint) * 2 / 3);
}

bool TileRasterizer::list(const Projection& projection, const gl::Buffer& drawn, std::size_t count,
                          int across, int down, gl::Stopwatch& stopwatch) {
  const std::size_t tiles = std::size_t(across) * std::size_t(down);
  counts_.reserve(count * sizeof(GLuint));
  total_.reserve(sizeof(GLuint));
  count_.use();
  projection.bindEllipses(count_);
  glUniform2i(count_.at("tiles"), across, down);
  count_.set("count", static_cast<GLuint>(count));
  drawn.bind(4);
  counts_.bind(5);
  gl::dispatch(groups(count));
  gl::storageBarrier();
  prefix_sum_.run(counts_, count, total_, 0);
  GLuint listed = 0;
  total_.read(0, &listed, sizeof(listed));
  if (listed > most_listed_) return false;

  tile_ranges_.reserve(2 * tiles * sizeof(GLuint));
  tile_ranges_.zero();
  if (listed > 0) {
    tiles_.reserve(listed * sizeof(GLuint));
    splats_.reserve(listed * sizeof(GLuint));
    list_.use();
    projection.bindEllipses(list_);
    glUniform2i(list_.at("tiles"), across, down);
    list_.set("count", static_cast<GLuint>(count));
    list_.set("listed", listed);
    drawn.bind(4);
    counts_.bind(5);
    tiles_.bind(6);
    splats_.bind(7);
    gl::dispatch(groups(count));
    gl::storageBarrier();
    stopwatch.lap("list");
    sort_.sort(tiles_, splats_, listed, bitsOf(tiles - 1), true);
    ranges_.use();
    ranges_.set("listed", listed);
    tiles_.bind(4);
    tile_ranges_.bind(5);
    gl::dispatch(groups(listed));
    gl::storageBarrier();
    stopwatch.lap("bin");
  }
  return true;
}

bool TileRasterizer::draw(const Projection& projection, const gl::Buffer& drawn, std::size_t count,
                          const gl::Target& target, const Raster& raster,
                          gl::Stopwatch& stopwatch) {
  const int across = (target.width() + kTile - 1) / kTile;
  const int down = (target.height() + kTile - 1) / kTile;
  if (listed_width_ != target.width() || listed_height_ != target.height()) {
    forget();
    if (!list(projection, drawn, count, across, down, stopwatch)) return false;
    listed_width_ = target.width();
    listed_height_ = target.height();
  }

  blend_.use();
  projection.bindEllipses(blend_);
  raster.set(blend_);
  glUniform2i(blend_.at("tiles"), across, down);
  glUniform2i(blend_.at("picture"), target.width(), target.height());
  blend_.set("top_first", int(raster.top_first));
  splats_.bind(4);
  tile_ranges_.bind(5);
  projection.depthRange().bind(6);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.depth());
  glBindImageTexture(0, target.color(), 0, GL_FALSE, 0, GL_WRITE_ONLY, target.format());
  gl::dispatch(std::size_t(across) * std::size_t(down));
  glMemoryBarrier(GL_TEXTURE_FETCH_BARRIER_BIT | GL_FRAMEBUFFER_BARRIER_BIT);
  stopwatch.lap("blend");
  return true;
}

std::size_t TileRasterizer::bytes() const {
  return counts_.bytes() + tiles_.bytes() + splats_.bytes() + tile_ranges_.bytes() +
         prefix_sum_.bytes();
}

}  // namespace rosplat
