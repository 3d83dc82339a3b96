// How it works. Work::run() draws a picture in slices of depth, so that what nearer slices hide
// costs little, and memory is that of one slice:
// 1. setViews, cull: what may show, page by page, then slot by slot.
// 2. deal: cuts that into slices of some 260,000 splats, nearest first.
// 3. For each slice, raisePyramid (depths behind which nothing shows, after Greene et al. 1993),
//    project what that doesn't hide, and list the splats by tiles.
// 4. sortTile, blend: each tile sorts its pairs by depth and blends them. One thread a tile, so
//    pictures are the same to the bit for any number of threads.
// 5. finish: depths. pick() and contribute() end otherwise from step 4 on.
// The order is exactly that of depth and slot. A slice that finds no memory is halved.

#include "rosplat_core/raster/cpu_rasterizer.hpp"

#include <algorithm>
#include <chrono>
#include <limits>
#include <new>
#include <utility>

#include "raster/raster_work.hpp"
#include "rosplat_core/slots/model.hpp"

namespace rosplat {

using Clock = std::chrono::steady_clock;

namespace {

constexpr int kLongestSide = 16384;  // [px], as in makeCamera()

const Kernels& kernelsFor(CpuRasterizer::Instructions wanted) {
  switch (available(wanted)) {
#if defined(__x86_64__)
    case CpuRasterizer::Instructions::kAvx512:
      return avx512::kKernels;
    case CpuRasterizer::Instructions::kAvx2:
      return avx2::kKernels;
#endif
    default:
      return plain::kKernels;
  }
}

// Returns run(). Throws PictureError if that finds no memory.
template <typename Run>
bool orSay(const SplatCamera& camera, const Run& run) {
  try {
    return run();
  } catch (const std::bad_alloc&) {
  } catch (const std::length_error&) {
  }
  throw PictureError("there is no memory for a picture of " + std::to_string(camera.width) + " x " +
                     std::to_string(camera.height) + " pixels");
}

// Throws PictureError for a camera whose picture is too small or too large.
void checkSize(const SplatCamera& camera) {
  const auto [least, most] = std::minmax(camera.width, camera.height);
  if (least >= 1 && most <= kLongestSide) return;
  throw PictureError("a picture of " + std::to_string(camera.width) + " x " +
                     std::to_string(camera.height) + " pixels can't be drawn, only 1 to " +
                     std::to_string(kLongestSide));
}

// Throws PictureError for samples that can't be drawn.
void checkSamples(const PictureRequest& request, std::size_t tiles) {
  const PictureSamples& samples = *request.samples;
  const std::size_t halves = 2 * tiles;
  bool fits = samples.begins.size == halves + 1 && samples.x.size == samples.y.size &&
              samples.begins[0] == 0 && samples.begins[halves] == samples.x.size;
  for (std::size_t i = 0; fits && i < halves; ++i) {
    fits = samples.begins[i] <= samples.begins[i + 1];
  }
  for (std::size_t i = 0; fits && i < halves; ++i) {
    const float* const y = samples.y.data;
    fits = std::is_sorted(y + samples.begins[i], y + samples.begins[i + 1]);
  }
  if (!fits) throw PictureError("samples do not fit the picture's tiles");
  for (const PictureLayer& layer : request.layers) {
    const Model model = layer.settings.drawnModel(layer.map->model);
    if (isEwa(model) || layer.camera.orthographic) {
      throw PictureError("only Ray and Disc are drawn by samples, not " + nameOf(model));
    }
  }
}

// Throws PictureError for a lens that nothing can be drawn through.
void checkLens(const PictureRequest& request) {
  const PictureLens& lens = *request.lens;
  const std::size_t parts = lens.curve.size / 4;
  if (parts < 1 || parts > 1 << 20 || lens.curve.size % 4 != 0 || !(lens.end > 0)) {
    throw PictureError("the lens has no curve");
  }
  for (const PictureLayer& layer : request.layers) {
    const Model model = layer.settings.drawnModel(layer.map->model);
    if (!isEwa(model) || layer.camera.orthographic) {
      throw PictureError("only EWA is drawn by a lens's curve, not " + nameOf(model));
    }
  }
}

// Throws PictureError for arrays by pixel, of objects or residuals, that are of another picture.
void checkPixels(const PictureRequest& request, std::size_t pixels) {
  for (const ArrayView<float>* values :
       {&request.scene_depth, &request.translucent_depth, &request.residual}) {
    if (values->empty() || values->size == pixels) continue;
    throw PictureError("numbers of " + std::to_string(values->size) +
                       " pixels do not fit a picture of " + std::to_string(pixels));
  }
}

}  // namespace

bool CpuRasterizer::Work::run(const PictureRequest& request, const Wanted& wanted) {
  begin(request);
  makeRoom(request, wanted);
  setViews(request);
  cull();
  if (cancelled()) return false;
  deal();
  lap("cull");
  openTiles(request);
  findDepthRanges();
  bool first = true, contributes = false;
  while (!waiting.empty()) {
    const DepthSlice slice = waiting.back();
    if (hides) raisePyramid();
    const bool fits = project(slice);
    lap("project");
    if (cancelled()) return false;
    if (!fits && slice.end - slice.begin > 1) {
      halve(waiting.size() - 1);
      continue;
    }
    waiting.pop_back();
    list();
    lap("list");
    // Contributions need the colour behind a splat. After several slices they take a second run.
    contributes = wanted.contributions && (wanted.drawn || (first && waiting.empty()));
    drawTiles(request, wanted, first, contributes);
    if (cancelled()) return false;
    lap("blend");
    for (const StepShare& part : parts) {
      for (std::size_t i = 0; i < layers.size(); ++i) layers[i].drawn += part.of_layers[i];
    }
    first = false;
    // Beside the camera, nothing is known to be hidden.
    if (request.samples || request.lens) continue;
    const auto end = open.begin() + std::ptrdiff_t(tiles);
    hides = hides || std::find(open.begin(), end, kEnded) != end;
  }
  if (wanted.blends()) finish(request, *wanted.picture);
  if (wanted.contributions && !contributes && !first) {
    return run(request, {wanted.picture, nullptr, wanted.contributions, true});
  }
  return true;
}

// Takes the request's sizes, and refuses what does not fit them.
void CpuRasterizer::Work::begin(const PictureRequest& request) {
  cancel = request.cancelled;
  profile.clear();
  began = Clock::now();
  const SplatCamera& camera = request.camera();
  checkSize(camera);
  across = (camera.width + kTile - 1) / kTile;
  down = (camera.height + kTile - 1) / kTile;
  tiles = std::size_t(across) * std::size_t(down);
  if (request.samples) checkSamples(request, tiles);
  if (request.lens) checkLens(request);
  pixels = request.samples ? request.samples->x.size
                           : std::size_t(camera.width) * std::size_t(camera.height);
  checkPixels(request, pixels);
}

// Makes room for what is wanted.
void CpuRasterizer::Work::makeRoom(const PictureRequest& request, const Wanted& wanted) {
  ends_at = wanted.contributions ? kLeastSeen : kTransparent;
  if (wanted.contributions) {
    remaining.resize(4 * pixels);
    const std::size_t capacity = request.layers.front().map->capacity;
    for (std::vector<float>* sums :
         {&wanted.contributions->weight, &wanted.contributions->energy,
          &wanted.contributions->error, &wanted.contributions->residual}) {
      sums->resize(capacity);
    }
  }
  if (!wanted.picture) {
    wanted.picked->resize(pixels);
    picking.resize(2 * pixels);
    return;
  }
  SplatPicture& picture = *wanted.picture;
  const SplatCamera& camera = request.camera();
  const bool kept = picture.width == camera.width && picture.height == camera.height;
  picture.width = picture.height = 0;  // in case there is no memory for all of the picture
  picture.colour.resize(4 * pixels);
  picture.depth.resize(request.depth == PictureDepth::kNone ? 0 : pixels);
  picture.tiles.resize(request.depth == PictureDepth::kMean && !request.samples ? tiles : 0);
  const std::size_t divided = request.translucent_depth.empty() ? 0 : pixels;
  if (!kept || picture.behind.size() != 4 * divided) {
    picture.behind.assign(4 * divided, 0.0f);
    picture.nearness.assign(2 * divided, 0.0f);
    picture.divided.assign(tiles, 0);
  }
  picture.width = camera.width;
  picture.height = camera.height;
}

// Sees all layers by their cameras, and chooses the pages that may show.
void CpuRasterizer::Work::setViews(const PictureRequest& request) {
  layers.resize(request.layers.size());
  for (std::size_t i = 0; i < layers.size(); ++i) {
    setView(request.layers[i], request, layers[i]);
  }
  conics = std::any_of(layers.begin(), layers.end(),
                       [](const SeenLayer& layer) { return !isEwa(layer.project.model); });
  planes = request.planes && request.depth != PictureDepth::kNone && !conics;
  for (SeenLayer& layer : layers) layer.project.planes = planes;
  ordered = request.order.has_value();
  if (ordered) setOrder(*request.layers.front().slots, *request.order);
  pages.clear();
  for (std::size_t i = 0; i < layers.size(); ++i) {
    choosePages(request.layers[i], static_cast<std::uint32_t>(i));
  }
}

// Draws the slice that is listed, tile by tile.
void CpuRasterizer::Work::drawTiles(const PictureRequest& request, const Wanted& wanted, bool first,
                                    bool contributes) {
  if (contributes) of_listed.reserve(total_pairs);
  std::atomic<std::size_t> next{0};
  rosplat::inParts(team.get(), members.size(), [&](std::size_t, unsigned number) {
    Member& member = members[number];
    for (std::size_t tile; (tile = next++) < tiles && !cancelled();) {
      sortTile(tile, member);
      if (!wanted.picture) pick(request, *wanted.picked, first, tile, member);
      if (wanted.blends()) {
        const auto draw = request.samples ? &Work::blendSamples : &Work::blend;
        (this->*draw)(request, *wanted.picture, first, tile, member);
      }
      if (contributes) contribute(request, *wanted.picture, first, tile, member);
    }
  });
  if (contributes && !cancelled()) addUp(*wanted.contributions);
}

// Makes depths of what was summed up, and tells what the layers drew.
void CpuRasterizer::Work::finish(const PictureRequest& request, SplatPicture& picture) {
  if (request.depth == PictureDepth::kMean && !request.samples) findMeanDepths(request, picture);
  if (request.depth == PictureDepth::kMean && request.samples) {
    for (std::size_t i = 0; i < pixels; ++i) picture.depth[i] /= picture.colour[4 * i + 3];
  }
  if (request.depth == PictureDepth::kMedian) {
    inParts(picture.depth.size(), 1 << 14, [&](const StepShare& part, Member&) {
      for (std::size_t i = part.begin; i < part.end; ++i) {
        if (picture.colour[4 * i + 3] >= 0.5f) continue;
        picture.depth[i] = std::numeric_limits<float>::quiet_NaN();
      }
    });
  }
  picture.layers.clear();
  for (const SeenLayer& layer : layers) picture.layers.push_back({layer.drawn, layer.error});
  picture.profile = profile;
}

CpuRasterizer::CpuRasterizer(std::shared_ptr<ThreadTeam> team, Instructions instructions)
    : work_(std::make_unique<Work>(std::move(team), kernelsFor(instructions))) {}

CpuRasterizer::~CpuRasterizer() = default;

bool CpuRasterizer::draw(const PictureRequest& request, SplatPicture& picture) {
  return orSay(request.camera(), [&] { return work_->run(request, {&picture}); });
}

std::vector<PickedSplat> CpuRasterizer::pick(const PictureRequest& request) {
  std::vector<std::uint32_t> indices;
  const bool whole =
      orSay(request.camera(), [&] { return work_->run(request, {nullptr, &indices}); });
  if (!whole) return {};
  std::vector<PickedSplat> picked(indices.size());
  for (std::size_t i = 0; i < indices.size(); ++i) {
    if (indices[i] != kNoSlot) picked[i] = work_->splatOf(indices[i]);
  }
  return picked;
}

bool CpuRasterizer::contribute(const PictureRequest& request, Contributions& contributions) {
  PictureRequest in_colour = request;
  in_colour.layers.front().settings.mode = DrawMode::kColor;
  in_colour.translucent_depth = {};
  return orSay(request.camera(),
               [&] { return work_->run(in_colour, {&work_->seen, nullptr, &contributions}); });
}

const char* CpuRasterizer::instructions() const { return work_->kernels.name; }

std::size_t CpuRasterizer::bytes() const {
  const Work& w = *work_;
  std::size_t bytes = w.ranks.bytes() + w.dealt.bytes() + w.records.bytes() + w.keys.bytes() +
                      w.listed.bytes() + w.of_listed.bytes() +
                      w.begins.capacity() * sizeof(w.begins[0]) +
                      w.pages.capacity() * sizeof(w.pages[0]);
  for (const StepShare& part : w.parts) {
    bytes += part.counts.capacity() * sizeof(part.counts[0]) + part.pairs.room * sizeof(Pair);
  }
  for (const Work::Member& member : w.members) bytes += sizeof(member) + member.spare.bytes();
  return bytes;
}

CpuRasterizer::Instructions available(CpuRasterizer::Instructions wanted) {
  using Instructions = CpuRasterizer::Instructions;
#if defined(__x86_64__) && defined(__GNUC__)
  __builtin_cpu_init();
  if (wanted >= Instructions::kAvx512 && __builtin_cpu_supports("avx512f") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512bw")) {
    return Instructions::kAvx512;
  }
  if (wanted >= Instructions::kAvx2 && __builtin_cpu_supports("avx2") &&
      __builtin_cpu_supports("fma")) {
    return Instructions::kAvx2;
  }
#else
  static_cast<void>(wanted);
#endif
  return Instructions::kPlain;
}

void toBytes(const float* values, std::size_t count, std::uint8_t* bytes) {
  kernelsFor(CpuRasterizer::Instructions::kBest).toBytes(values, count, bytes);
}

}  // namespace rosplat
