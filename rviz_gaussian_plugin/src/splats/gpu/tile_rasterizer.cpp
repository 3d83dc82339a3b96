#include "gpu/tile_rasterizer.hpp"

#include <algorithm>
#include <array>

namespace rosplat {

namespace {

constexpr int kPatience = 64;  // pictures, until memory that was lacking may be there
// 1.25 GiB with what sorts them.
std::size_t mostPairs() {
  return std::min(std::size_t{1} << 26, gl::largestStorageBuffer() / sizeof(GLuint));
}

}  // namespace

TileRasterizer::TileRasterizer(Shaders& shaders, RadixSort& sort, const Tallies& tallies)
    : count_(shaders.compute(
          {"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl", "tile_count.comp"})),
      list_(shaders.compute(
          {"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl", "tile_list.comp"})),
      ranges_(shaders.compute({"tile_ranges.comp"})),
      blend_(shaders.compute({"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl",
                              "splat_colour.glsl", "tile_blend.comp"})),
      blend_divided_(
          shaders.compute({"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl",
                           "splat_colour.glsl", "splat_behind.glsl", "tile_blend.comp"})),
      blend_shares_(shaders.compute({"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl",
                                     "splat_colour.glsl", "splat_shares.glsl", "tile_blend.comp"})),
      blend_shares_divided_(shaders.compute(
          {"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl", "splat_colour.glsl",
           "splat_shares.glsl", "splat_behind.glsl", "tile_blend.comp"})),
      prefix_sum_(shaders),
      sort_(sort),
      pair_count_(tallies.of(Tallies::kPairs)),
      zero_(tallies.of(Tallies::kZero)),
      most_pairs_(mostPairs()) {
  const std::array<GLuint, Tally::kBytes / sizeof(GLuint)> zeros{};
  zero_.write(zeros.data());
}

bool TileRasterizer::checkRoom(std::size_t pairs, double growth) {
  refused_ = pairs > most_pairs_;
  if (pairs <= room_) {
    if (used_.wastes(pairs)) room_ = withSlack(pairs);
    return true;
  }
  listed_ = false;
  if (!refused_) room_ = std::min(withSlack(pairs, growth), most_pairs_);
  return false;
}

bool TileRasterizer::count(const OrderedSplats& splats, int width, int height) {
  if (out_of_memory_ > 0 && --out_of_memory_ == 0) most_pairs_ = mostPairs();
  const std::size_t room = std::max(room_, splats.most());
  width_ = width;
  height_ = height;
  listed_ = false;
  room_ = 0;  // should there be no memory
  try {
    prefix_sum_.reserve(splats.most());
    sort_.reserve(room);
    if (splats_.bytes() / 4 > room * sizeof(GLuint)) splats_.release();
    splats_.reserve(room * sizeof(GLuint));
  } catch (const gl::Error&) {
    splats_.release();
    most_pairs_ = room / 2;
    out_of_memory_ = kPatience;
    refused_ = true;
    return false;
  }
  room_ = room;
  const gl::Buffer& counts = sort_.spare();
  count_.use();
  splats.projection().bindEllipses(count_);
  count_.bind("Drawn", splats.drawn());
  count_.bind("Counts", counts);
  count_.bind("Length", splats.tally().words());
  count_.bind("Boxes", splats.projection().boxes());
  splats.tally().dispatchGroups();
  gl::storageBarrier();
  prefix_sum_.run(counts, splats.tally(), pair_count_, room_);
  return true;
}

void TileRasterizer::list(const OrderedSplats& splats, gl::Stopwatch& stopwatch) {
  const std::size_t tiles = std::size_t(tilesIn(width_)) * std::size_t(tilesIn(height_));
  begins_.reserve((tiles + 1) * sizeof(GLuint));
  list_.use();
  splats.projection().bindEllipses(list_);
  list_.bind("Drawn", splats.drawn());
  list_.bind("Firsts", sort_.spare());
  list_.bind("Length", splats.tally().words());
  list_.bind("Listed", pair_count_.words());
  list_.bind("Tiles", sort_.keys());
  list_.bind("Splats", sort_.values());
  list_.bind("Boxes", splats.projection().boxes());
  splats.tally().dispatchGroups();
  gl::storageBarrier();
  stopwatch.lap("list");
  sort_.sort(pair_count_, zero_, std::max(bitsOf(tiles - 1), 1), splats_);
  ranges_.use();
  ranges_.set("tile_count", static_cast<GLuint>(tiles));
  ranges_.bind("Tiles", sort_.keys());
  ranges_.bind("Begins", begins_);
  ranges_.bind("Length", pair_count_.words());
  gl::dispatchInvocations(tiles + 1);
  gl::storageBarrier();
  stopwatch.lap("bin");
  listed_ = true;
}

void TileRasterizer::blend(const OrderedSplats& splats, const gl::Target& target,
                           const gl::Target* behind) const {
  const bool shares = splats.projection().hasShares();
  const gl::Program& program = shares   ? behind ? blend_shares_divided_ : blend_shares_
                               : behind ? blend_divided_
                                        : blend_;
  program.use();
  splats.projection().bindEllipses(program);
  program.bind("Splats", splats_);
  program.bind("Begins", begins_);
  program.bind("DepthRange", splats.projection().depthRange());
  if (shares) program.bind("Shares", splats.projection().shares());
  if (behind) {
    glActiveTexture(GL_TEXTURE1);
    glBindTexture(GL_TEXTURE_2D, behind->depth());
    glBindImageTexture(1, behind->color(), 0, GL_FALSE, 0, GL_WRITE_ONLY, behind->format());
    glBindImageTexture(2, behind->second(), 0, GL_FALSE, 0, GL_WRITE_ONLY, GL_RG32F);
  }
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.depth());
  glBindImageTexture(0, target.color(), 0, GL_FALSE, 0, GL_WRITE_ONLY, target.format());
  gl::dispatch(std::size_t(tilesIn(target.width())) * std::size_t(tilesIn(target.height())));
  glMemoryBarrier(GL_TEXTURE_FETCH_BARRIER_BIT | GL_FRAMEBUFFER_BARRIER_BIT |
                  GL_SHADER_IMAGE_ACCESS_BARRIER_BIT);  // what comes may be blended once more
}

std::size_t TileRasterizer::bytes() const {
  return splats_.bytes() + begins_.bytes() + prefix_sum_.bytes();
}

}  // namespace rosplat
