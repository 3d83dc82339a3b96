#include "refit/refit_kernels.hpp"

#include "raster/simd.hpp"

namespace rosplat::cpu::ROSPLAT_TARGET {

namespace {

constexpr int kPixels = kTile * kTile;
constexpr float kLog2E = 1.44269504f;
constexpr std::size_t kPatience = 16;  // splats between two checks of ended()

struct alignas(64) Planes {
  float transmittance[kPixels];
  float colour[3][kPixels];
};

float sumOf(Floats v) {
  float sum = 0;
  for (int i = 0; i < kLanes; ++i) sum += v[i];
  return sum;
}

bool ended(const float* transmittance) {
  Floats largest = {};
  for (int i = 0; i < kPixels; i += kLanes) largest = max(largest, load(transmittance + i));
  for (int i = 0; i < kLanes; ++i) {
    if (largest[i] >= kTransparent) return false;
  }
  return true;
}

// Calls each(pixel, dx, dy, alpha) for the vectors of pixels that a splat covers. alpha: not yet
// clamped to kMaxAlpha; 0 where it is below the cutoff.
template <typename Each>
void overPixels(const FitTile& tile, const FitSplat& e, const Each& each) {
  const int first = e.top > tile.top ? e.top - tile.top : 0;
  const int last = (e.bottom < tile.bottom ? e.bottom : tile.bottom) - tile.top;
  const int begin = (e.left > tile.left ? e.left - tile.left : 0) / kLanes * kLanes;
  const int end = (e.right < tile.right ? e.right : tile.right) - tile.left;
  const Floats halved = all(0.5f * kLog2E);
  const Floats a = e.a * halved, b = e.b * (halved + halved), c = e.c * halved;
  for (int column = begin; column < end; column += kLanes) {
    const Floats dx = counting() + (float(tile.left + column) + 0.5f - e.x);
    const Floats inside = fma(-a * dx, dx, all(e.log2_peak)), slope = b * dx;
    for (int row = first; row < last; ++row) {
      const Floats dy = all(float(tile.top + row) + 0.5f - e.y);
      const Floats exponent = fma(-dy, fma(c, dy, slope), inside);
      const Ints covered = exponent >= kLog2Cutoff;
      if (!any(covered)) continue;
      const Floats alpha = covered ? exp2(max(exponent, all(kLog2Cutoff))) : Floats{};
      each(kTile * row + column, dx, dy, alpha);
    }
  }
}

}  // namespace

double fitTile(const FitTile& tile) {
  Planes planes;
  for (float& value : planes.transmittance) value = 1.0f;
  for (auto& plane : planes.colour) {
    for (float& value : plane) value = 0.0f;
  }
  std::size_t count = 0;
  for (; count < tile.count; ++count) {
    if (count % kPatience == 0 && ended(planes.transmittance)) break;
    const FitSplat& e = tile.splats[tile.listed[count]];
    overPixels(tile, e, [&](int pixel, Floats, Floats, Floats unclamped) {
      const Floats alpha = min(unclamped, all(kMaxAlpha));
      const Floats transmittance = load(planes.transmittance + pixel);
      const Floats weight = transmittance * alpha;
      store(planes.transmittance + pixel, transmittance - weight);
      for (int i = 0; i < 3; ++i) {
        float* const channel = planes.colour[i] + pixel;
        store(channel, fma(weight, all(e.colour[i]), load(channel)));
      }
    });
  }

  // The derivative by each pixel's colour: none beyond the picture, where vectors of pixels reach.
  // behind: its dot product with the colour that splats farther back still add.
  alignas(64) float gradients[3][kPixels] = {}, behind[kPixels] = {};
  double error = 0;
  for (int row = 0; row < tile.bottom - tile.top; ++row) {
    const float* wanted =
        tile.target + 3 * (std::ptrdiff_t(tile.top + row) * tile.width + tile.left);
    for (int column = 0; column < tile.right - tile.left; ++column) {
      const int pixel = kTile * row + column;
      for (int i = 0; i < 3; ++i) {
        const float colour = planes.colour[i][pixel];
        const float shown = colour < 1.0f ? colour : 1.0f;
        const float difference = shown - *wanted++;
        error += double(difference) * difference;
        const float gradient = tile.gradient_scale * difference;
        behind[pixel] += gradient * colour;
        gradients[i][pixel] = gradient;
      }
    }
  }

  for (float& value : planes.transmittance) value = 1.0f;
  for (std::size_t k = 0; k < count; ++k) {
    const FitSplat& e = tile.splats[tile.listed[k]];
    Floats p_sum = {}, px = {}, py = {}, pxx = {}, pxy = {}, pyy = {}, colours[3] = {};
    overPixels(tile, e, [&](int pixel, Floats dx, Floats dy, Floats unclamped) {
      const Floats alpha = min(unclamped, all(kMaxAlpha));
      const Floats transmittance = load(planes.transmittance + pixel);
      const Floats weight = transmittance * alpha;
      store(planes.transmittance + pixel, transmittance - weight);
      Floats along = {};
      for (int i = 0; i < 3; ++i) {
        const Floats gradient = load(gradients[i] + pixel);
        along = fma(gradient, all(e.colour[i]), along);
        colours[i] = fma(weight, gradient, colours[i]);
      }
      const Floats left = fma(-weight, along, load(behind + pixel));
      store(behind + pixel, left);
      const Floats by_alpha = transmittance * along - left / (1.0f - alpha);
      // Where alpha is clamped, a little more opacity changes nothing.
      const Floats p = unclamped < kMaxAlpha ? by_alpha * alpha : Floats{};
      const Floats along_x = p * dx, along_y = p * dy;
      p_sum += p;
      px += along_x;
      py += along_y;
      pxx = fma(along_x, dx, pxx);
      pxy = fma(along_x, dy, pxy);
      pyy = fma(along_y, dy, pyy);
    });
    tile.sums[k] = {sumOf(p_sum),
                    sumOf(px),
                    sumOf(py),
                    sumOf(pxx),
                    sumOf(pxy),
                    sumOf(pyy),
                    {sumOf(colours[0]), sumOf(colours[1]), sumOf(colours[2])}};
  }
  for (std::size_t k = count; k < tile.count; ++k) tile.sums[k] = {};
  return error;
}

}  // namespace rosplat::cpu::ROSPLAT_TARGET
