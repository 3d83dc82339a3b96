// How it works. From splats in order of depth to pixels, with macro tiles as HiGS has them
// (arXiv:2606.00352):
// 1. listMacroPairs: pairs each splat with the macro tiles of 128x64 pixels that its outline
//    touches, and sorts the pairs by macro tile, stably (macro_count.comp, macro_list.comp).
// 2. listByTiles: each block of 256 splats of a macro tile finds which of its 32 tiles they touch,
//    and writes them to these tiles' lists, without gaps (tile_touch.comp, tile_list.comp).
// 3. blendTiles: a work group for each tile of 16x16 pixels blends its list front to back in 32-bit
//    floats, up to the opaque depth, until nothing behind shows (tile_blend.comp).
// 4. blendInSegments: lists beyond 2,048 splats are cut, blended side by side, and laid over.
// Where all lists take too much memory, the picture is made region by region (picture_regions.hpp).
// No list lacks a splat whose alpha reaches 1/255 in its tile.

#include "gpu/tile_rasterizer.hpp"

#include <algorithm>
#include <array>
#include <initializer_list>
#include <vector>

#include "gl/driver.hpp"

namespace rosplat {

namespace {

constexpr int kPatience = 64;        // lists until memory that was lacking is tried again
constexpr std::size_t kListed = 32;  // splats counted together, as in macro_tiles.glsl
// Tiles across and down a macro tile, as in splat_tiles.glsl.
constexpr int kMacroColumns = 8, kMacroRows = 4;
constexpr std::size_t kBlockSplats = 256;  // of a macro tile's list, as in tile_touching.glsl
static_assert(kBlockSplats == 8 * kMacroColumns * kMacroRows);  // words that a block's tiles have

// What a segment leaves: four floats for each of 256 pixels.
constexpr std::size_t kPartialBytes = 4 * sizeof(GLfloat) * 256;
constexpr std::size_t kLeastRoom = 16;        // memory for less than this is lacking for good
constexpr std::size_t kMostSegments = 65535;  // every driver dispatches as many in one dimension
// After blending: the picture may be drawn, or blended once more.
constexpr GLbitfield kReadNext =
    GL_TEXTURE_FETCH_BARRIER_BIT | GL_FRAMEBUFFER_BARRIER_BIT | GL_SHADER_IMAGE_ACCESS_BARRIER_BIT;

// Returns the most that a region's lists may have: together, pairs take 2 GiB.
TileRasterizer::Wanted mostRoom() {
  const std::size_t words = gl::largestStorageBuffer() / sizeof(GLuint);
  return {std::min(std::size_t{1} << 26, words / 2), std::min(std::size_t{1} << 28, words),
          std::min(kMostSegments, gl::largestStorageBuffer() / kPartialBytes)};
}

// Returns the program that blends tiles. of: the files that say what kinds of splats it blends.
ShapedProgram blender(Shaders& shaders, std::initializer_list<const char*> of) {
  Shaders::Files files{"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl",
                       "splat_colour.glsl"};
  files.insert(files.end(), of);
  files.push_back("tile_blend.comp");
  return {shaders, files};
}

}  // namespace

TileRasterizer::TileRasterizer(Shaders& shaders, RadixSort& sort, const Tallies& tallies)
    : count_(shaders,
             {"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl", "tile_segments.glsl",
              "macro_tiles.glsl", "splat_counts.glsl", "macro_count.comp"}),
      list_macros_(shaders, {"splat_ellipses.glsl", "splat_exactly.glsl", "splat_tiles.glsl",
                             "macro_tiles.glsl", "splat_counts.glsl", "macro_list.comp"}),
      touch_(shaders,
             {"splat_ellipses.glsl", "splat_tiles.glsl", "tile_touching.glsl", "tile_touch.comp"}),
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
      blend_depths_(blender(shaders, {"tile_segments.glsl", "splat_balls.glsl", "splat_shares.glsl",
                                      "splat_depths.glsl"})),
      blend_medians_(blender(shaders, {"splat_balls.glsl", "splat_shares.glsl", "splat_depths.glsl",
                                       "splat_median.glsl"})),
      sort_(sort),
      tallies_(tallies),
      macro_pairs_(tallies.of(Tallies::kMacroPairs)),
      wanted_(tallies.of(Tallies::kLists)),
      room_{},
      most_(mostRoom()) {}

void TileRasterizer::list(const OrderedSplats& splats, int width, int height, std::size_t region,
                          gl::Stopwatch& stopwatch) {
  if (patience_ > 0 && --patience_ == 0) most_ = mostRoom();
  width_ = width;
  height_ = height;
  listed_ = false;
  regions_.begin(region, macroColumns(), macroRows());
  if (region == 0) leaves_out_ = false;
  reserve(splats);
  // The region before may still read what this one writes.
  if (regions_.count() > 1) gl::storageBarrier();
  listMacroPairs(splats);
  stopwatch.lap("list");
  listByTiles(splats);
  stopwatch.lap("bin");
  listed_ = regions_.count() == 1;
}

bool TileRasterizer::checkRoom(const Wanted& wanted, double growth) {
  const auto fits = [this](std::size_t macro_pairs, std::size_t pairs) {
    return macro_pairs <= most_.macro_pairs && pairs <= most_.pairs;
  };
  const std::size_t times =
      1 + std::max(wanted.macro_pairs / (most_.macro_pairs + 1), wanted.pairs / (most_.pairs + 1));
  if (times > 1 && regions_.split(times)) {
    listed_ = false;
    return false;
  }
  leaves_out_ = leaves_out_ || times > 1;
  const Wanted needed{std::min(wanted.macro_pairs, most_.macro_pairs),
                      std::min(wanted.pairs, most_.pairs),
                      std::min(wanted.segments, most_.segments)};
  bool enough = true;
  const auto adapt = [&](std::size_t& room, UsageTracker& used, std::size_t need,
                         std::size_t most) {
    const bool lacks = need > room;
    if (used.noteUse(need) || lacks) room = std::min(withSlack(need, growth), most);
    enough = enough && !lacks;
  };
  adapt(room_.macro_pairs, macro_pairs_used_, needed.macro_pairs, most_.macro_pairs);
  adapt(room_.pairs, pairs_used_, needed.pairs, most_.pairs);
  adapt(room_.segments, segments_used_, needed.segments, most_.segments);
  expected_ = wanted.macro_pairs;
  listed_ = listed_ && enough;
  if (!enough) return false;
  if (regions_.number() % 2 == 0) {
    even_ = wanted;
  } else if (fits(withSlack(even_.macro_pairs + wanted.macro_pairs),
                  withSlack(even_.pairs + wanted.pairs))) {
    regions_.noteFit();
  }
  return true;
}

void TileRasterizer::reserve(const OrderedSplats& splats) {
  const auto reserve = [](gl::Buffer& buffer, std::size_t bytes) {
    if (buffer.bytes() / 4 > bytes) buffer.release();
    buffer.reserve(bytes);
  };
  // Where memory is lacking, makes do with half, and so on.
  const auto reserveMost = [this](std::size_t& room, std::size_t& most, const auto& reserve_room) {
    while (true) {
      try {
        return reserve_room();
      } catch (const gl::Error&) {
        if (room < kLeastRoom) throw;
        most = room /= 2;
        patience_ = kPatience;
      }
    }
  };
  begins_.reserve((macroTiles() + 1) * sizeof(GLuint));
  lists_.reserve(tiles() * 3 * sizeof(GLuint));
  // As much as there is room for in `drawn`, which seldom grows.
  room_.macro_pairs = std::min(std::max(room_.macro_pairs, splats.drawn().bytes() / sizeof(GLuint)),
                               most_.macro_pairs);
  reserveMost(room_.macro_pairs, most_.macro_pairs, [&] {
    const std::size_t blocks = room_.macro_pairs / kBlockSplats + 1;
    sort_.reserve(std::max(blocks * kBlockSplats, splats.most()));  // boxes of all are there, too
    reserve(splats_, room_.macro_pairs * sizeof(GLuint));
    places_.reserve((blocks + macroTiles()) * kMacroColumns * kMacroRows * sizeof(GLuint));
  });
  reserveMost(room_.pairs, most_.pairs, [&] {
    reserve(listed_splats_, std::max<std::size_t>(room_.pairs, 1) * sizeof(GLuint));
  });
  reserveMost(room_.segments, most_.segments,
              [&] { reserve(partials_, room_.segments * kPartialBytes); });
  segments_.reserve((1 + room_.segments) * sizeof(GLuint));
}

// Lists the splats with the macro tiles that they touch, in the splats' order.
void TileRasterizer::listMacroPairs(const OrderedSplats& splats) {
  const std::size_t work_groups = std::max(ceilDiv(splats.expected(), 256), 1u);
  const auto begin = [&](const gl::Program& program) {
    program.use();
    splats.projection().bindEllipses(program);
    counts_.bind(program);
    program.bind("Drawn", splats.drawn());
    program.bind("DrawnTally", splats.tally());
    program.bind("OrderedBoxes", sort_.spareKeys());
    program.bind("MacroPairs", macro_pairs_);
    program.set("region", regions_.region());
  };
  counts_.begin(ceilDiv(splats.most(), kListed));
  const Shapes shapes = splats.projection().shapes();
  const gl::Program &count = count_.of(shapes), &list_macros = list_macros_.of(shapes);
  begin(count);
  count.bind("Boxes", splats.projection().boxes());
  count.bind("Segments", segments_);
  count.bind("Wanted", wanted_);
  gl::dispatch(work_groups);
  gl::storageBarrier();
  begin(list_macros);
  list_macros.bind("Keys", sort_.keys());
  list_macros.bind("Splats", sort_.values(macroBits(), splats_));
  list_macros.set("room", static_cast<GLuint>(room_.macro_pairs));
  gl::dispatch(work_groups);
  gl::storageBarrier();
}

// Sorts these pairs by macro tile, and lists the splats with the tiles that they touch.
void TileRasterizer::listByTiles(const OrderedSplats& splats) {
  const std::size_t expected = likely(expected_, room_.macro_pairs);
  const std::size_t blocks = std::max<std::size_t>(ceilDiv(expected, kBlockSplats), 1);
  sort_.sort(macro_pairs_, expected, macroBits(), splats_);
  const gl::Program& touch = touch_.of(splats.projection().shapes());
  touch.use();
  splats.projection().bindEllipses(touch);
  bindTouching(touch);
  gl::dispatch(blocks);
  gl::storageBarrier();
  place_.use();
  bindTouching(place_);
  place_.bind("Lists", lists_);
  place_.bind("Segments", segments_);
  place_.bind("Wanted", wanted_);
  place_.set("room", static_cast<GLuint>(room_.pairs));
  place_.set("segments_room", static_cast<GLuint>(room_.segments));
  gl::dispatch(macroTiles());
  gl::storageBarrier();
  list_.use();
  bindTouching(list_);
  list_.bind("Listed", listed_splats_);
  tallies_.bind(list_);
  list_.set("room", static_cast<GLuint>(room_.pairs));
  gl::dispatch(blocks);
  gl::storageBarrier();
}

void TileRasterizer::bindTouching(const gl::Program& program) const {
  program.bind("Keys", sort_.keys());
  program.bind("Splats", splats_);
  program.bind("MacroPairs", macro_pairs_);
  program.bind("Begins", begins_);
  program.bind("Touching", sort_.spareKeys());  // a word a splat: free, since the lists are sorted
  program.bind("Places", places_);
}

void TileRasterizer::blend(const OrderedSplats& splats, const gl::Target& target,
                           const gl::Target* behind) {
  const bool shares = splats.projection().hasShares();
  const Shapes shapes = splats.projection().shapes();
  if (!behind) {
    const ShapedProgram& blend = shares ? blend_shares_ : splats.hasBalls() ? blend_balls_ : blend_;
    return blendInSegments(blend.of(shapes), splats, target);
  }
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, behind->depth());
  glBindImageTexture(1, behind->color(), 0, GL_FALSE, 0, GL_WRITE_ONLY, behind->format());
  glBindImageTexture(2, behind->second(), 0, GL_FALSE, 0, GL_WRITE_ONLY, GL_RG32F);
  blendTiles((shares ? blend_shares_divided_ : blend_divided_).of(shapes), splats, target);
  glMemoryBarrier(kReadNext);
}

void TileRasterizer::blendDepth(const OrderedSplats& splats, PictureDepth depth,
                                const gl::Target& target) {
  const Shapes shapes = splats.projection().shapes();
  if (depth == PictureDepth::kMean) {
    return blendInSegments(blend_depths_.of(shapes), splats, target);
  }
  blendTiles(blend_medians_.of(shapes), splats, target);  // which end where half is left
  glMemoryBarrier(kReadNext);
}

void TileRasterizer::blendInSegments(const gl::Program& program, const OrderedSplats& splats,
                                     const gl::Target& target) {
  program.use();
  program.bind("Segments", segments_);
  program.bind("Partials", partials_);
  program.set("later", 0);
  blendTiles(program, splats, target);
  if (room_.segments == 0) return glMemoryBarrier(kReadNext);  // no list is cut
  gl::storageBarrier();
  program.set("later", 1);
  gl::dispatch(room_.segments);
  gl::storageBarrier();
  composite_.use();
  composite_.bind("Segments", segments_);
  composite_.bind("Partials", partials_);
  composite_.bind("Lists", lists_);
  gl::dispatch(room_.segments);
  glMemoryBarrier(kReadNext);
}

void TileRasterizer::blendTiles(const gl::Program& program, const OrderedSplats& splats,
                                const gl::Target& target) const {
  program.use();
  splats.projection().bindEllipses(program);
  program.bind("Seen", splats.projection().seen());
  program.bind("Shares", splats.projection().shares());
  program.bind("Planes", splats.projection().planes());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.depth());
  glBindImageTexture(0, target.color(), 0, GL_FALSE, 0, GL_WRITE_ONLY, target.format());
  dispatchTiles(program);
}

void TileRasterizer::dispatchTiles(const gl::Program& program) const {
  program.bind("Listed", listed_splats_);
  program.bind("Lists", lists_);
  const PictureRegions::Region& region = regions_.region();
  program.set("region", region);
  const auto tilesAcross = [](GLint first, GLint last, int each, int tiles) {
    return static_cast<std::size_t>(std::min(last * each, tiles) - first * each);
  };
  gl::dispatch(tilesAcross(region[0], region[2], kMacroColumns, tilesIn(width_)) *
               tilesAcross(region[1], region[3], kMacroRows, tilesIn(height_)));
}

int TileRasterizer::macroColumns() const {
  return static_cast<int>(ceilDiv(std::size_t(tilesIn(width_)), kMacroColumns));
}

int TileRasterizer::macroBits() const { return std::max(bitsOf(macroTiles() - 1), 1); }

int TileRasterizer::macroRows() const {
  return static_cast<int>(ceilDiv(std::size_t(tilesIn(height_)), kMacroRows));
}

std::size_t TileRasterizer::bytes() const {
  return counts_.bytes() + splats_.bytes() + begins_.bytes() + places_.bytes() +
         listed_splats_.bytes() + lists_.bytes() + segments_.bytes() + partials_.bytes();
}

}  // namespace rosplat
