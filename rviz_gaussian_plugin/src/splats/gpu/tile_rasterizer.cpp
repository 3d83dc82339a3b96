#include "gpu/tile_rasterizer.hpp"

#include <algorithm>
#include <array>
#include <initializer_list>
#include <vector>

namespace rosplat {

namespace {

constexpr int kPatience = 64;             // pictures until memory that was lacking is tried again
constexpr std::size_t kListed = 32;       // splats counted together, as in splat_tiles.glsl
constexpr std::size_t kRangesEach = 255;  // tiles, as in tile_ranges.comp
// Splats of a work group that lists them, and how many splats are few; as in tile_list.comp.
constexpr std::size_t kListedEach = 256, kFewListedEach = 64, kFewSplats = 524288;

// Splats in a tile's first and in its later segments. With shorter first segments the last work
// groups end sooner, but more splats are blended that walls hide.
constexpr GLuint kFirstSegment = 2048, kLaterSegment = 1024;
constexpr std::size_t kMostLater = 32768;  // every driver dispatches as many in one dimension
// The work groups of tile_segments.glsl: none yet.
constexpr std::array<GLuint, 6> kNoGroups{0, 1, 1, 0, 1, 1};
constexpr GLintptr kLaterGroups = 0, kCutGroups = 3 * sizeof(GLuint);

GLuint laterSegment(std::size_t room) {
  return std::max(kLaterSegment, static_cast<GLuint>(room / kMostLater));
}

// Returns for how many keys the sort's buffers need room to hold the partials of segments of so
// many pairs: a word a pair, as a segment of 1,024 pairs or more leaves 256 pixels of four floats.
std::size_t roomForPartials(std::size_t pairs) { return pairs + kLaterSegment; }

// Returns how many pairs may be listed: with the buffers that sort them, these take 1 GiB.
std::size_t mostPairs() {
  return std::min(std::size_t{1} << 26,
                  gl::largestStorageBuffer() / sizeof(GLuint) - kLaterSegment);
}

// Returns the program that blends tiles. of: the files that say what kinds of splats it blends.
const gl::Program& blender(Shaders& shaders, std::initializer_list<const char*> of) {
  std::vector<const char*> files{"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl",
                                 "splat_colour.glsl"};
  files.insert(files.end(), of);
  files.push_back("tile_blend.comp");
  return shaders.compute(files);
}

}  // namespace

TileRasterizer::TileRasterizer(Shaders& shaders, RadixSort& sort, const Tallies& tallies)
    : count_(shaders.compute(
          {"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl", "tile_count.comp"})),
      list_(shaders.compute(
          {"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl", "tile_list.comp"})),
      ranges_(shaders.compute({"tile_segments.glsl", "tile_ranges.comp"})),
      composite_(
          shaders.compute({"splat_tiles.glsl", "tile_segments.glsl", "tile_composite.comp"})),
      blend_(blender(shaders, {"tile_segments.glsl"})),
      blend_balls_(blender(shaders, {"tile_segments.glsl", "splat_balls.glsl"})),
      blend_divided_(blender(shaders, {"splat_balls.glsl", "splat_behind.glsl"})),
      blend_shares_(
          blender(shaders, {"tile_segments.glsl", "splat_balls.glsl", "splat_shares.glsl"})),
      blend_shares_divided_(
          blender(shaders, {"splat_balls.glsl", "splat_shares.glsl", "splat_behind.glsl"})),
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
  room_ = 0;  // stays so if memory is lacking
  try {
    counts_.reserve((splats.most() / kListed + 1) * sizeof(GLuint));
    prefix_sum_.reserve(splats.most() / kListed + 1);
    sort_.reserve(roomForPartials(room));
    if (splats_.bytes() / 4 > room * sizeof(GLuint)) splats_.release();
    splats_.reserve(room * sizeof(GLuint));
    most_cut_ = static_cast<GLuint>(room / kFirstSegment) + 1;
    later_segment_ = laterSegment(room);
    begins_.reserve((tiles() + 1) * sizeof(GLuint));
    segments_.reserve(sizeof(kNoGroups) +
                      (tiles() + 2 * std::size_t{most_cut_} + room / later_segment_ + 1) *
                          sizeof(GLuint));
  } catch (const gl::Error&) {
    splats_.release();
    most_pairs_ = room / 2;
    out_of_memory_ = kPatience;
    refused_ = true;
    return false;
  }
  room_ = room;
  count_.use();
  splats.projection().bindEllipses(count_);
  count_.bind("Drawn", splats.drawn());
  count_.bind("Within", sort_.spareKeys());
  count_.bind("Counts", counts_);
  count_.bind("Length", splats.tally().words());
  count_.bind("Boxes", splats.projection().boxes());
  splats.tally().dispatchGroups();
  gl::storageBarrier();
  prefix_sum_.run(counts_, splats.tally(), pair_count_, room_, kListed);
  return true;
}

void TileRasterizer::list(const OrderedSplats& splats, gl::Stopwatch& stopwatch) {
  const int bits = std::max(bitsOf(tiles() - 1), 1);
  list_.use();
  splats.projection().bindEllipses(list_);
  list_.bind("Drawn", splats.drawn());
  list_.bind("Within", sort_.spareKeys());
  list_.bind("Firsts", counts_);
  list_.bind("Length", splats.tally().words());
  list_.bind("Listed", pair_count_.words());
  list_.bind("Tiles", sort_.keys());
  list_.bind("Splats", sort_.values(bits, splats_));
  list_.bind("Boxes", splats.projection().boxes());
  // Work groups beyond the count end at once.
  gl::dispatch(std::max(ceilDiv(std::min(splats.most(), kFewSplats), kFewListedEach),
                        ceilDiv(splats.most(), kListedEach)));
  gl::storageBarrier();
  stopwatch.lap("list");
  sort_.sort(pair_count_, zero_, bits, splats_);
  segments_.write(0, kNoGroups.data(), sizeof(kNoGroups));
  ranges_.use();
  useSegments(ranges_);
  ranges_.bind("Tiles", sort_.keys());
  ranges_.bind("Begins", begins_);
  ranges_.bind("Length", pair_count_.words());
  gl::dispatch(tiles() / kRangesEach + 1);
  gl::storageBarrier();
  glMemoryBarrier(GL_COMMAND_BARRIER_BIT);
  stopwatch.lap("bin");
  listed_ = true;
}

void TileRasterizer::blend(const OrderedSplats& splats, const gl::Target& target,
                           const gl::Target* behind) {
  const bool shares = splats.projection().hasShares();
  const gl::Program& program = shares              ? behind ? blend_shares_divided_ : blend_shares_
                               : behind            ? blend_divided_
                               : splats.hasBalls() ? blend_balls_
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
  if (!behind) {
    sort_.reserve(roomForPartials(room_));  // another view may have shrunk the buffers
    useSegments(program);
    program.set("later", 0);
  }
  gl::dispatch(tiles());
  if (!behind) {
    gl::storageBarrier();
    program.set("later", 1);
    glBindBuffer(GL_DISPATCH_INDIRECT_BUFFER, segments_.id());
    glDispatchComputeIndirect(kLaterGroups);
    gl::storageBarrier();
    composite_.use();
    useSegments(composite_);
    composite_.bind("Begins", begins_);
    glDispatchComputeIndirect(kCutGroups);
  }
  glMemoryBarrier(GL_TEXTURE_FETCH_BARRIER_BIT | GL_FRAMEBUFFER_BARRIER_BIT |
                  GL_SHADER_IMAGE_ACCESS_BARRIER_BIT);  // the picture may be blended once more
}

void TileRasterizer::useSegments(const gl::Program& program) const {
  program.bind("Segments", segments_);
  // The sort's buffers are free: the lists are sorted, their tiles' beginnings known.
  program.bind("FirstPartials", sort_.spareKeys());
  program.bind("LaterPartials", sort_.spareValues());
  program.set("first_segment", kFirstSegment);
  program.set("later_segment", later_segment_);
  program.set("most_cut", most_cut_);
}

std::size_t TileRasterizer::bytes() const {
  return splats_.bytes() + begins_.bytes() + segments_.bytes() + counts_.bytes() +
         prefix_sum_.bytes();
}

}  // namespace rosplat
