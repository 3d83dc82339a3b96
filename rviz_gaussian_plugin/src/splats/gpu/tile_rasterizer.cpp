#include "gpu/tile_rasterizer.hpp"

#include <algorithm>
#include <array>
#include <initializer_list>
#include <vector>

namespace rosplat {

namespace {

constexpr int kPatience = 64;        // pictures until memory that was lacking is tried again
constexpr std::size_t kListed = 32;  // splats counted together, as in macro_tiles.glsl
// Tiles across and down a macro tile, as in splat_tiles.glsl.
constexpr int kMacroColumns = 8, kMacroRows = 4;
constexpr std::size_t kBlockSplats = 256;  // of a macro tile's list, as in tile_touching.glsl
static_assert(kBlockSplats == 8 * kMacroColumns * kMacroRows);  // words that a block's tiles have

// What a segment leaves: four floats for each of 256 pixels.
constexpr std::size_t kPartialBytes = 4 * sizeof(GLfloat) * 256;
constexpr std::size_t kGroupWords = 3;        // of tile_segments.glsl, before `tiles`
constexpr std::size_t kFewSegments = 16;      // there is room for these, even if none is needed
constexpr std::size_t kMostSegments = 65535;  // every driver dispatches as many in one dimension

// Return how many pairs of a splat and a macro tile, or a tile, may be listed. All take 2 GiB.
std::size_t mostMacroPairs() {
  return std::min(std::size_t{1} << 26, gl::largestStorageBuffer() / (2 * sizeof(GLuint)));
}

std::size_t mostPairs() {
  return std::min(std::size_t{1} << 28, gl::largestStorageBuffer() / sizeof(GLuint));
}

std::size_t mostSegments() {
  return std::min(kMostSegments, gl::largestStorageBuffer() / kPartialBytes);
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
    : count_(shaders.compute({"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl",
                              "macro_tiles.glsl", "macro_count.comp"})),
      list_macros_(shaders.compute({"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl",
                                    "macro_tiles.glsl", "macro_list.comp"})),
      touch_(shaders.compute({"splat_ellipses.glsl", "splat_tiles.glsl", "tile_touching.glsl",
                              "tile_segments.glsl", "tile_touch.comp"})),
      place_(shaders.compute(
          {"splat_tiles.glsl", "tile_touching.glsl", "tile_segments.glsl", "tile_places.comp"})),
      list_(shaders.compute({"splat_tiles.glsl", "tile_touching.glsl", "tile_list.comp"})),
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
      macro_pair_count_(tallies.of(Tallies::kMacroPairs)),
      zero_(tallies.of(Tallies::kZero)),
      wanted_(tallies.of(Tallies::kLists)),
      segments_room_(kFewSegments),
      most_macro_pairs_(mostMacroPairs()) {
  const std::array<GLuint, Tally::kBytes / sizeof(GLuint)> zeros{};
  zero_.write(zeros.data());
  wanted_.write(zeros.data());
}

bool TileRasterizer::checkRoom(std::size_t macro_pairs, double growth) {
  refused_ = macro_pairs > most_macro_pairs_;
  if (refused_ || macro_pairs > macro_room_) {
    listed_ = false;
    if (!refused_) macro_room_ = std::min(withSlack(macro_pairs, growth), most_macro_pairs_);
    return false;
  }
  if (macro_used_.wastes(macro_pairs)) macro_room_ = withSlack(macro_pairs);
  return true;
}

bool TileRasterizer::checkLists(std::size_t pairs, std::size_t segments, double growth) {
  segments = std::min(segments, mostSegments());
  const bool enough = pairs <= room_ && segments <= segments_room_;
  if (!enough) listed_ = false;
  refused_ = refused_ || pairs > mostPairs();
  if (!refused_ && (used_.wastes(pairs) || pairs > room_)) {
    room_ = std::min(withSlack(pairs, growth), mostPairs());
  }
  if (segments_used_.wastes(segments) || segments > segments_room_) {
    segments_room_ = std::clamp(withSlack(segments), kFewSegments, mostSegments());
  }
  return enough;
}

bool TileRasterizer::count(const OrderedSplats& splats, int width, int height) {
  if (patience_ > 0 && --patience_ == 0) most_macro_pairs_ = mostMacroPairs();
  width_ = width;
  height_ = height;
  listed_ = false;
  macro_room_ = std::max(macro_room_, splats.most());
  try {
    reserve(splats.most());
  } catch (const gl::Error&) {
    most_macro_pairs_ = macro_room_ / 2;
    patience_ = kPatience;
    refused_ = true;
    for (gl::Buffer* buffer : {&listed_splats_, &partials_}) buffer->release();
    macro_room_ = room_ = 0;
    segments_room_ = kFewSegments;
    return false;
  }
  count_.use();
  splats.projection().bindEllipses(count_);
  count_.bind("Drawn", splats.drawn());
  count_.bind("Boxes", splats.projection().boxes());
  count_.bind("OrderedBoxes", sort_.spareKeys());
  count_.bind("Counts", counts_);
  count_.bind("Length", splats.tally().words());
  splats.tally().dispatchGroups();
  gl::storageBarrier();
  prefix_sum_.run(counts_, splats.tally(), macro_pair_count_, macro_room_, kListed);
  return true;
}

void TileRasterizer::reserve(std::size_t splats) {
  const auto reserve = [](gl::Buffer& buffer, std::size_t bytes) {
    if (buffer.bytes() / 4 > bytes) buffer.release();
    buffer.reserve(bytes);
  };
  counts_.reserve((splats / kListed + 1) * sizeof(GLuint));
  prefix_sum_.reserve(splats / kListed + 1);
  const std::size_t blocks = macro_room_ / kBlockSplats + 1;
  sort_.reserve(blocks * kBlockSplats);
  reserve(splats_, macro_room_ * sizeof(GLuint));
  reserve(listed_splats_, std::max<std::size_t>(room_, 1) * sizeof(GLuint));
  reserve(partials_, segments_room_ * kPartialBytes);
  begins_.reserve((macroTiles() + 1) * sizeof(GLuint));
  places_.reserve((blocks + macroTiles()) * kMacroColumns * kMacroRows * sizeof(GLuint));
  lists_.reserve(tiles() * 3 * sizeof(GLuint));
  if (segments_.bytes() < (kGroupWords + segments_room_) * sizeof(GLuint)) {
    segments_.reserve((kGroupWords + segments_room_) * sizeof(GLuint));
    constexpr std::array<GLuint, kGroupWords> kNoGroups{0, 1, 1};
    segments_.write(0, kNoGroups.data(), sizeof(kNoGroups));
  }
}

void TileRasterizer::list(const OrderedSplats& splats, gl::Stopwatch& stopwatch) {
  const int bits = std::max(bitsOf(macroTiles() - 1), 1);
  list_macros_.use();
  splats.projection().bindEllipses(list_macros_);
  list_macros_.bind("Drawn", splats.drawn());
  list_macros_.bind("OrderedBoxes", sort_.spareKeys());
  list_macros_.bind("Firsts", counts_);
  list_macros_.bind("Length", splats.tally().words());
  list_macros_.bind("MacroPairs", macro_pair_count_.words());
  list_macros_.bind("Keys", sort_.keys());
  list_macros_.bind("Splats", sort_.values(bits, splats_));
  splats.tally().dispatchGroups();
  gl::storageBarrier();
  stopwatch.lap("list");
  sort_.sort(macro_pair_count_, zero_, bits, splats_);
  touch_.use();
  splats.projection().bindEllipses(touch_);
  bindTouching(touch_);
  touch_.bind("Segments", segments_);
  touch_.bind("Wanted", wanted_);
  macro_pair_count_.dispatchGroups();
  gl::storageBarrier();
  place_.use();
  bindTouching(place_);
  place_.bind("Lists", lists_);
  place_.bind("Segments", segments_);
  place_.bind("Wanted", wanted_);
  place_.set("room", static_cast<GLuint>(room_));
  place_.set("segments_room", static_cast<GLuint>(segments_room_));
  gl::dispatch(macroTiles());
  gl::storageBarrier();
  list_.use();
  bindTouching(list_);
  list_.bind("Listed", listed_splats_);
  list_.set("room", static_cast<GLuint>(room_));
  macro_pair_count_.dispatchGroups();
  gl::storageBarrier();
  glMemoryBarrier(GL_COMMAND_BARRIER_BIT);
  stopwatch.lap("bin");
  listed_ = true;
}

void TileRasterizer::bindTouching(const gl::Program& program) const {
  program.bind("Keys", sort_.keys());
  program.bind("Splats", splats_);
  program.bind("MacroPairs", macro_pair_count_.words());
  program.bind("Begins", begins_);
  program.bind("Touching", sort_.spareKeys());  // a word a splat: free, since the lists are sorted
  program.bind("Places", places_);
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
  program.bind("Listed", listed_splats_);
  program.bind("Lists", lists_);
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
    program.bind("Segments", segments_);
    program.bind("Partials", partials_);
    program.set("later", 0);
  }
  gl::dispatch(tiles());
  if (!behind) {
    gl::storageBarrier();
    program.set("later", 1);
    glBindBuffer(GL_DISPATCH_INDIRECT_BUFFER, segments_.id());
    glDispatchComputeIndirect(0);
    gl::storageBarrier();
    composite_.use();
    composite_.bind("Segments", segments_);
    composite_.bind("Partials", partials_);
    composite_.bind("Lists", lists_);
    glDispatchComputeIndirect(0);
  }
  glMemoryBarrier(GL_TEXTURE_FETCH_BARRIER_BIT | GL_FRAMEBUFFER_BARRIER_BIT |
                  GL_SHADER_IMAGE_ACCESS_BARRIER_BIT);  // the picture may be blended once more
}

std::size_t TileRasterizer::macroTiles() const {
  return ceilDiv(std::size_t(tilesIn(width_)), kMacroColumns) *
         std::size_t(ceilDiv(std::size_t(tilesIn(height_)), kMacroRows));
}

std::size_t TileRasterizer::bytes() const {
  return counts_.bytes() + prefix_sum_.bytes() + splats_.bytes() + begins_.bytes() +
         places_.bytes() + listed_splats_.bytes() + lists_.bytes() + segments_.bytes() +
         partials_.bytes();
}

}  // namespace rosplat
