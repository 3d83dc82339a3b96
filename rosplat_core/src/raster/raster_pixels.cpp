// Stages that work tile by tile: blending, picking, finding contributions.

#include <algorithm>
#include <cstring>
#include <numeric>
#include <utility>

#include "raster/raster_work.hpp"

namespace rosplat {

namespace {

// Copies a tile's depths, 1 beyond the picture. Returns null if nothing is nearer than 1.
const float* depthsOf(const ArrayView<float>& depths, const TileRect& rect, float* copy) {
  if (depths.empty()) return nullptr;
  std::fill_n(copy, kTilePixels, 1.0f);
  float nearest = 1;
  rect.forEach([&](std::size_t i, std::size_t pixel) {
    copy[i] = depths[pixel];
    nearest = std::min(nearest, copy[i]);
  });
  return nearest < 1 ? copy : nullptr;
}

}  // namespace

ListedTile CpuRasterizer::Work::listedTile(const PictureRequest& request, const TileRect& rect,
                                           std::size_t tile, Member& member) const {
  return {listed.get() + begins[tile],
          inTile(tile),
          records.get(),
          conics || planes ? shapes.get() : nullptr,
          planes,
          {},
          rect.left,
          rect.top,
          depthsOf(request.scene_depth, rect, member.opaque)};
}

void CpuRasterizer::Work::blend(const PictureRequest& request, SplatPicture& picture, bool first,
                                std::size_t number, Member& member) {
  if (inTile(number) == 0 && !first) return;
  const TileRect rect(number, across, picture.width, picture.height);
  const float* const divided = depthsOf(request.translucent_depth, rect, member.divided);
  const BlendTile tile{listedTile(request, rect, number, member), ends_at, &member.pixels,
                       divided ? &member.behind : nullptr, divided};
  if (first && !picture.behind.empty()) {
    const bool was_divided = std::exchange(picture.divided[number], divided != nullptr);
    if (was_divided && !divided) {
      rect.forEach([&](std::size_t, std::size_t pixel) {
        std::fill_n(&picture.behind[4 * pixel], 4, 0.0f);
        std::fill_n(&picture.nearness[2 * pixel], 2, 0.0f);
      });
    }
  }
  // Former slices are blended into the picture already.
  const auto read = [&](TilePixels& pixels, const std::vector<float>& colour) {
    std::memset(&pixels, 0, sizeof(pixels));
    rect.forEach([&](std::size_t i, std::size_t pixel) {
      pixels.transmittance[i] = first ? 1 : 1 - colour[4 * pixel + 3];
      for (int k = 0; k < 3 && !first; ++k) pixels.colour[k][i] = colour[4 * pixel + k];
    });
  };
  read(member.pixels, picture.colour);
  if (request.depth != PictureDepth::kNone && !first) {
    rect.forEach(
        [&](std::size_t i, std::size_t pixel) { member.pixels.depth[i] = picture.depth[pixel]; });
  }
  if (divided) {
    read(member.behind, picture.behind);
    rect.forEach([&](std::size_t i, std::size_t pixel) {
      if (!first) member.behind.depth[i] = picture.nearness[2 * pixel];
    });
  }

  const bool ended = kernels.blend(tile, request.depth);
  if (ended) open[number] = kEnded;

  const auto write = [&](const TilePixels& pixels, std::vector<float>& colour) {
    rect.forEach([&](std::size_t i, std::size_t pixel) {
      float* const rgba = &colour[4 * pixel];
      for (int k = 0; k < 3; ++k) rgba[k] = pixels.colour[k][i];
      rgba[3] = 1 - pixels.transmittance[i];
    });
  };
  write(member.pixels, picture.colour);
  if (request.depth != PictureDepth::kNone) {
    rect.forEach(
        [&](std::size_t i, std::size_t pixel) { picture.depth[pixel] = member.pixels.depth[i]; });
  }
  if (divided) {
    write(member.behind, picture.behind);
    rect.forEach([&](std::size_t i, std::size_t pixel) {
      picture.nearness[2 * pixel] = member.behind.depth[i];
      picture.nearness[2 * pixel + 1] = 1 - member.behind.transmittance[i];
    });
  }
}

// Blends a tile's samples, at most as many at a time as a tile has pixels.
void CpuRasterizer::Work::blendSamples(const PictureRequest& request, SplatPicture& picture,
                                       bool first, std::size_t number, Member& member) {
  if (inTile(number) == 0 && !first) return;
  const PictureSamples& samples = *request.samples;
  const bool deep = request.depth != PictureDepth::kNone;
  TilePixels& pixels = member.pixels;
  BlendTile tile{};
  tile.listed = listed.get() + begins[number];
  tile.count = inTile(number);
  tile.records = records.get();
  tile.shapes = shapes.get();
  tile.left = int(number) % across * kTile;
  tile.top = int(number) / across * kTile;
  tile.ends_at = ends_at;
  tile.pixels = &pixels;
  float* const x = member.opaque;
  float* const y = member.divided;
  tile.samples.x = x, tile.samples.y = y;
  const std::uint32_t* const halves = samples.begins.data + 2 * number;
  const std::size_t most = std::max(halves[1] - halves[0], halves[2] - halves[1]);
  for (std::size_t done = 0; done < most; done += kHalfTile) {
    std::memset(&pixels, 0, sizeof(pixels));
    // Calls each(place in the tile, sample) for those of one half.
    const auto forEach = [&](int half, const auto& each) {
      const std::size_t begin = std::min<std::size_t>(halves[half] + done, halves[half + 1]);
      const std::size_t end = std::min<std::size_t>(begin + kHalfTile, halves[half + 1]);
      for (std::size_t i = begin; i < end; ++i) each(half * kHalfTile + (i - begin), i);
    };
    for (int half = 0; half < 2; ++half) {
      std::fill_n(x + half * kHalfTile, kHalfTile, 0.0f);
      std::fill_n(y + half * kHalfTile, kHalfTile, 0.0f);
      std::uint16_t* const rows = tile.samples.rows[half];
      std::fill_n(rows, kTile + 1, std::uint16_t{});
      forEach(half, [&](std::size_t place, std::size_t i) {
        x[place] = samples.x[i] - float(tile.left);
        y[place] = samples.y[i] - float(tile.top);
        ++rows[std::clamp(int(y[place]), 0, kTile - 1) + 1];
        const float* const rgba = &picture.colour[4 * i];
        pixels.transmittance[place] = first ? 1 : 1 - rgba[3];
        for (int k = 0; k < 3 && !first; ++k) pixels.colour[k][place] = rgba[k];
        if (deep && !first) pixels.depth[place] = picture.depth[i];
      });
      std::partial_sum(rows, rows + kTile + 1, rows);
    }
    kernels.blend(tile, request.depth);
    for (int half = 0; half < 2; ++half) {
      forEach(half, [&](std::size_t place, std::size_t i) {
        float* const rgba = &picture.colour[4 * i];
        for (int k = 0; k < 3; ++k) rgba[k] = pixels.colour[k][place];
        rgba[3] = 1 - pixels.transmittance[place];
        if (deep) picture.depth[i] = pixels.depth[place];
      });
    }
  }
}

void CpuRasterizer::Work::pick(const PictureRequest& request, std::vector<std::uint32_t>& picked,
                               bool first, std::size_t number, Member& member) {
  if (inTile(number) == 0 && !first) return;
  const SplatCamera& camera = request.camera();
  const TileRect rect(number, across, camera.width, camera.height);
  const PickTile tile{listedTile(request, rect, number, member), member.pixels.transmittance,
                      member.most, member.indices};
  std::fill_n(tile.transmittance, kTilePixels, 0.0f);
  rect.forEach([&](std::size_t i, std::size_t pixel) {
    tile.transmittance[i] = first ? 1 : picking[2 * pixel];
    tile.most[i] = first ? kLeastPicked : picking[2 * pixel + 1];
    tile.index[i] = first ? kNoSlot : picked[pixel];
  });
  const bool ended = kernels.pick(tile);
  if (ended) open[number] = kEnded;
  rect.forEach([&](std::size_t i, std::size_t pixel) {
    picking[2 * pixel] = tile.transmittance[i];
    picking[2 * pixel + 1] = tile.most[i];
    picked[pixel] = tile.index[i];
  });
}

void CpuRasterizer::Work::contribute(const PictureRequest& request, const SplatPicture& picture,
                                     bool first, std::size_t number, Member& member) {
  if (inTile(number) == 0 && !first) return;
  const TileRect rect(number, across, picture.width, picture.height);
  ContributeTile tile{listedTile(request, rect, number, member), ends_at, nullptr, &member.pixels,
                      of_listed.get() + begins[number]};
  if (!request.residual.empty()) {
    std::fill_n(member.most, kTilePixels, 0.0f);
    rect.forEach(
        [&](std::size_t i, std::size_t pixel) { member.most[i] = request.residual[pixel]; });
    tile.residual = member.most;
  }
  std::memset(&member.pixels, 0, sizeof(member.pixels));
  rect.forEach([&](std::size_t i, std::size_t pixel) {
    member.pixels.transmittance[i] = first ? 1 : remaining[4 * pixel + 3];
    for (int k = 0; k < 3; ++k) {
      member.pixels.colour[k][i] = first ? picture.colour[4 * pixel + k] : remaining[4 * pixel + k];
    }
  });
  if (kernels.contribute(tile)) open[number] = kEnded;
  rect.forEach([&](std::size_t i, std::size_t pixel) {
    for (int k = 0; k < 3; ++k) remaining[4 * pixel + k] = member.pixels.colour[k][i];
    remaining[4 * pixel + 3] = member.pixels.transmittance[i];
  });
}

void CpuRasterizer::Work::findMeanDepths(const PictureRequest& request, SplatPicture& picture) {
  const bool orthographic = request.camera().orthographic;
  inParts(tiles, 64, [&](const StepShare& part, Member&) {
    for (std::size_t number = part.begin; number < part.end; ++number) {
      const TileRect rect(number, across, picture.width, picture.height);
      const bool divided = !picture.divided.empty() && picture.divided[number];
      picture.tiles[number] = kernels.findDepths(
          {&picture.colour[4 * rect.first], divided ? &picture.behind[4 * rect.first] : nullptr,
           &picture.depth[rect.first], rect.stride, rect.width, rect.height, orthographic});
    }
  });
}

// Adds in the order of tiles, so that sums are the same for any number of threads.
void CpuRasterizer::Work::addUp(Contributions& contributions) {
  of_records.assign(parts.back().end, {});
  for (std::size_t i = 0; i < total_pairs; ++i) {
    Contribution& sum = of_records[listed[i].record];
    sum.weight += of_listed[i].weight;
    sum.energy += of_listed[i].energy;
    sum.error += of_listed[i].error;
    sum.residual += of_listed[i].residual;
  }
  for (const StepShare& part : parts) {
    for (std::size_t i = part.begin; i < part.begin + part.drawn; ++i) {
      const std::uint32_t slot = splatOf(records[i].index).slot;
      contributions.weight[slot] += of_records[i].weight;
      contributions.energy[slot] += of_records[i].energy;
      contributions.error[slot] += of_records[i].error;
      contributions.residual[slot] += of_records[i].residual;
    }
  }
}

}  // namespace rosplat
