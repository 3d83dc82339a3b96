#include "gpu/tile_rasterizer.hpp"

#include <algorithm>
#include <array>

namespace rosplat {

namespace {

constexpr std::size_t kMostPairs = std::size_t{1} << 26;  // 1 GiB with what sorts them

}  // namespace

TileRasterizer::TileRasterizer(const Shaders& shaders, RadixSort& sort, const Tallies& tallies)
    : count_(shaders.compute(
          {"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl", "tile_count.comp"})),
      list_(shaders.compute(
          {"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl", "tile_list.comp"})),
      ranges_(shaders.compute({"tile_ranges.comp"})),
      blend_(shaders.compute(
          {"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl", "tile_blend.comp"})),
      blend_divided_(shaders.compute({"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl",
                                      "splat_behind.glsl", "tile_blend.comp"})),
      prefix_sum_(shaders),
      sort_(sort),
      pair_count_(tallies.of(Tallies::kPairs)),
      zero_(tallies.of(Tallies::kZero)) {
  const std::array<GLuint, Tally::kBytes / sizeof(GLuint)> zeros{};
  zero_.write(zeros.data());
  most_pairs_ = std::min(kMostPairs, gl::largestStorageBuffer() / sizeof(GLuint));
}

bool TileRasterizer::reserve(std::size_t pairs, std::size_t better) {
  refused_ = pairs > most_pairs_;
  if (pairs > room_) {
    listed_ = false;
    if (!refused_) room_ = std::min(better, most_pairs_);
  }
  return !refused_;
}

bool TileRasterizer::counted(const gl::Target& target) const {
  return counted_width_ == target.width() && counted_height_ == target.height();
}

bool TileRasterizer::count(const OrderedSplats& splats, const gl::Target& target,
                           gl::Stopwatch& stopwatch) {
  const int across = tilesIn(target.width()), down = tilesIn(target.height());
  const std::size_t room = std::max(room_, splats.most());
  counted_width_ = target.width();
  counted_height_ = target.height();
  listed_ = false;
  room_ = 0;  // should there be no memory
  try {
    prefix_sum_.reserve(splats.most());
    sort_.reserve(room);
  } catch (const gl::Error&) {
    most_pairs_ = room / 2;
    refused_ = true;
    return false;
  }
  room_ = room;
  const gl::Buffer& counts = sort_.spare();
  count_.use();
  splats.projection().bindEllipses(count_);
  glUniform2i(count_.at("tiles"), across, down);
  splats.drawn().bind(4);
  counts.bind(5);
  splats.tally().bind(6);
  splats.projection().boxes().bind(7);
  splats.tally().dispatchGroups();
  gl::storageBarrier();
  prefix_sum_.run(counts, splats.tally(), pair_count_, room_);
  stopwatch.lap("list");
  return true;
}

void TileRasterizer::list(const OrderedSplats& splats, const gl::Target& target,
                          gl::Stopwatch& stopwatch) {
  const int across = tilesIn(target.width()), down = tilesIn(target.height());
  const std::size_t tiles = std::size_t(across) * std::size_t(down);
  begins_.reserve((tiles + 1) * sizeof(GLuint));
  list_.use();
  splats.projection().bindEllipses(list_);
  glUniform2i(list_.at("tiles"), across, down);
  splats.drawn().bind(4);
  sort_.spare().bind(5);
  splats.tally().bind(6);
  pair_count_.bind(7);
  sort_.keys().bind(8);
  sort_.values().bind(9);
  splats.projection().boxes().bind(10);
  splats.tally().dispatchGroups();
  gl::storageBarrier();
  stopwatch.lap("list");
  sort_.sort(pair_count_, zero_, bitsOf(tiles - 1));
  ranges_.use();
  ranges_.set("tile_count", static_cast<GLuint>(tiles));
  sort_.keys().bind(4);
  begins_.bind(5);
  pair_count_.bind(6);
  gl::dispatchInvocations(tiles + 1);
  gl::storageBarrier();
  stopwatch.lap("bin");
  listed_ = true;
}

void TileRasterizer::blend(const OrderedSplats& splats, const gl::Target& target,
                           const gl::Target* behind, const Raster& raster) const {
  const int across = tilesIn(target.width()), down = tilesIn(target.height());
  const gl::Program& program = behind ? blend_divided_ : blend_;
  program.use();
  splats.projection().bindEllipses(program);
  raster.set(program);
  glUniform2i(program.at("tiles"), across, down);
  glUniform2i(program.at("picture"), target.width(), target.height());
  program.set("top_first", int(raster.top_first));
  bindLists(4, 5);
  splats.projection().depthRange().bind(6);
  if (behind) {
    glActiveTexture(GL_TEXTURE1);
    glBindTexture(GL_TEXTURE_2D, behind->depth());
    glBindImageTexture(1, behind->color(), 0, GL_FALSE, 0, GL_WRITE_ONLY, behind->format());
    glBindImageTexture(2, behind->second(), 0, GL_FALSE, 0, GL_WRITE_ONLY, GL_RG32F);
  }
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.depth());
  glBindImageTexture(0, target.color(), 0, GL_FALSE, 0, GL_WRITE_ONLY, target.format());
  gl::dispatch(std::size_t(across) * std::size_t(down));
  glMemoryBarrier(GL_TEXTURE_FETCH_BARRIER_BIT | GL_FRAMEBUFFER_BARRIER_BIT |
                  GL_SHADER_IMAGE_ACCESS_BARRIER_BIT);  // what comes may be blended once more
}

std::size_t TileRasterizer::bytes() const { return begins_.bytes() + prefix_sum_.bytes(); }

}  // namespace rosplat
