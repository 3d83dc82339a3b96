#include "rosplat_core/refit/refit.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>

#include "refit/refit_kernels.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/threads/in_parts.hpp"

namespace rosplat {

using cpu::FitSplat;
using cpu::FitSums;
using cpu::FitTile;

namespace {

// Where each kind begins among a splat's values.
constexpr std::size_t kPosition = 0, kScale = 3, kRotation = 6, kOpacity = 10, kHarmonics = 11;
constexpr std::size_t kMostValues = kHarmonics + 48;
constexpr std::size_t kChunk = 4096;  // splats that one thread projects at a time
constexpr float kMostLogit = 9.0f;    // keeps opacities where they still have a gradient

cpu::FitTileFunction functionFor(CpuRasterizer::Instructions wanted) {
  switch (available(wanted)) {
#if defined(__x86_64__)
    case CpuRasterizer::Instructions::kAvx512:
      return cpu::avx512::fitTile;
    case CpuRasterizer::Instructions::kAvx2:
      return cpu::avx2::fitTile;
#endif
    default:
      return cpu::plain::fitTile;
  }
}

// Harmonics of Kerbl et al. 2023 for a direction of length 1.
void basisOf(int degree, float x, float y, float z, float* basis) {
  basis[0] = float(kShC0);
  if (degree < 1) return;
  constexpr float k1 = 0.48860251f;
  basis[1] = -k1 * y, basis[2] = k1 * z, basis[3] = -k1 * x;
  if (degree < 2) return;
  constexpr float k2 = 1.09254843f;
  const float xx = x * x, yy = y * y, zz = z * z;
  basis[4] = k2 * x * y, basis[5] = -k2 * y * z;
  basis[6] = 0.31539157f * (2 * zz - xx - yy);
  basis[7] = -k2 * x * z, basis[8] = 0.54627422f * (xx - yy);
  if (degree < 3) return;
  basis[9] = -0.59004359f * y * (3 * xx - yy), basis[10] = 2.89061144f * x * y * z;
  basis[11] = -0.45704580f * y * (4 * zz - xx - yy);
  basis[12] = 0.37317633f * z * (2 * zz - 3 * xx - 3 * yy);
  basis[13] = -0.45704580f * x * (4 * zz - xx - yy);
  basis[14] = 1.44530572f * z * (xx - yy), basis[15] = -0.59004359f * x * (xx - 3 * yy);
}

// A splat that project() has projected: what backward() needs.
struct ProjectedSplat {
  float at[3];           // position in the camera's frame [m]
  float jacobian[2][3];  // d pixel / d at
  bool clamped[2];       // the tangent in the third column, along x and y
  float axes[3][3];      // columns of the rotation: [row][axis]
  float scales[3];
  float rows[2][3];     // J W
  float m[2][3];        // J W R S
  float opacity, kept;  // kept: the share that antialiasing leaves
  float det0, det;
  float a0, b, c0;  // covariance without the low-pass filter [px^2]
  float basis[16];
};

}  // namespace

struct Refit::Drawing {
  float to_camera[3][4];
  float eye[3];
  float fx, fy, cx, cy, near_clip, far_clip;
  float least_tangent[2], most_tangent[2];
  bool orthographic, antialiased;
  int width, height, degree;

  Drawing(const SplatCamera& camera, const std::array<double, 3>& origin, bool of_antialiased,
          int of_degree)
      : fx(float(camera.fx)),
        fy(float(camera.fy)),
        cx(float(camera.cx)),
        cy(float(camera.cy)),
        near_clip(float(camera.near_clip)),
        far_clip(float(camera.far_clip)),
        orthographic(camera.orthographic),
        antialiased(of_antialiased),
        width(camera.width),
        height(camera.height),
        degree(of_degree) {
    const std::array<double, 3> eye_at = eyeOf(camera, origin), moved = camera(origin);
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t k = 0; k < 3; ++k) to_camera[i][k] = float(camera.rotation[3 * i + k]);
      to_camera[i][3] = float(moved[i]);
      eye[i] = float(eye_at[i]);
    }
    const SplatCamera::Whole whole = camera.whole();
    const double focal[2] = {camera.fx, camera.fy}, centre[2] = {whole.cx, whole.cy};
    const double size[2] = {whole.width, whole.height};
    for (int i = 0; i < 2; ++i) {  // as in the rasteriser
      const double slack = kTangentSlack * size[i] / focal[i];
      least_tangent[i] = float(-centre[i] / focal[i] - slack);
      most_tangent[i] = float((size[i] - centre[i]) / focal[i] + slack);
    }
  }

  // Projects a splat. Returns false if the picture shows nothing of it.
  bool project(const float* values, ProjectedSplat& p, FitSplat& splat) const {
    for (int i = 0; i < 3; ++i) {
      const float* const row = to_camera[i];
      p.at[i] = row[0] * values[0] + row[1] * values[1] + row[2] * values[2] + row[3];
    }
    const float z = p.at[2];
    if (!(z > near_clip && z < far_clip)) return false;
    const float focal[2] = {fx, fy};
    float tangent[2];
    for (int i = 0; i < 2; ++i) {
      const float straight = orthographic ? 0.0f : p.at[i] / z;
      tangent[i] = std::clamp(straight, least_tangent[i], most_tangent[i]);
      p.clamped[i] = tangent[i] != straight;
      p.jacobian[i][1 - i] = 0;
      p.jacobian[i][i] = orthographic ? focal[i] : focal[i] / z;
      p.jacobian[i][2] = orthographic ? 0.0f : -focal[i] * tangent[i] / z;
    }
    splat.x = (orthographic ? p.at[0] * fx : p.at[0] / z * fx) + cx;
    splat.y = (orthographic ? p.at[1] * fy : p.at[1] / z * fy) + cy;
    splat.depth = z;

    const float* q = values + kRotation;
    const float over = 1 / std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    const float x = q[0] * over, y = q[1] * over, qz = q[2] * over, w = q[3] * over;
    const float axes[3][3] = {
        {1 - 2 * (y * y + qz * qz), 2 * (x * y - w * qz), 2 * (x * qz + w * y)},
        {2 * (x * y + w * qz), 1 - 2 * (x * x + qz * qz), 2 * (y * qz - w * x)},
        {2 * (x * qz - w * y), 2 * (y * qz + w * x), 1 - 2 * (x * x + y * y)}};
    std::copy_n(&axes[0][0], 9, &p.axes[0][0]);
    for (int k = 0; k < 3; ++k) p.scales[k] = std::exp(values[kScale + std::size_t(k)]);
    for (int i = 0; i < 2; ++i) {
      for (int k = 0; k < 3; ++k) {
        p.rows[i][k] = p.jacobian[i][i] * to_camera[i][k] + p.jacobian[i][2] * to_camera[2][k];
      }
      for (int k = 0; k < 3; ++k) {
        p.m[i][k] = p.scales[k] * (p.rows[i][0] * axes[0][k] + p.rows[i][1] * axes[1][k] +
                                   p.rows[i][2] * axes[2][k]);
      }
    }
    const auto& [first, second] = p.m;
    p.a0 = first[0] * first[0] + first[1] * first[1] + first[2] * first[2];
    p.b = first[0] * second[0] + first[1] * second[1] + first[2] * second[2];
    p.c0 = second[0] * second[0] + second[1] * second[1] + second[2] * second[2];
    const float area[3] = {first[1] * second[2] - first[2] * second[1],
                           first[2] * second[0] - first[0] * second[2],
                           first[0] * second[1] - first[1] * second[0]};
    p.det0 = area[0] * area[0] + area[1] * area[1] + area[2] * area[2];
    p.det = p.det0 + kLowPass * (p.a0 + p.c0) + kLowPass * kLowPass;
    const float a = p.a0 + kLowPass, c = p.c0 + kLowPass;
    if (!(p.det > 0 && p.det < 1e30f)) return false;
    splat.a = c / p.det, splat.b = -p.b / p.det, splat.c = a / p.det;

    p.opacity = 1 / (1 + std::exp(-values[kOpacity]));
    p.kept = antialiased ? std::sqrt(p.det0 / p.det) : 1.0f;
    const float peak = p.opacity * p.kept;
    if (!(peak >= kCutoffAlpha)) return false;
    splat.log2_peak = std::log2(peak);
    const float sigmas = std::sqrt(2 * std::log(peak / kCutoffAlpha));
    const float reach_x = sigmas * std::sqrt(a), reach_y = sigmas * std::sqrt(c);
    const auto pixel = [](float at, int size) {
      return std::int16_t(std::clamp(at, 0.0f, float(size)));
    };
    splat.left = pixel(splat.x - reach_x, width), splat.right = pixel(splat.x + reach_x + 1, width);
    splat.top = pixel(splat.y - reach_y, height);
    splat.bottom = pixel(splat.y + reach_y + 1, height);
    if (splat.left >= splat.right || splat.top >= splat.bottom) return false;

    float way[3] = {to_camera[2][0], to_camera[2][1], to_camera[2][2]};
    if (!orthographic) {
      for (int i = 0; i < 3; ++i) way[i] = values[i] - eye[i];
    }
    const float length = std::sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
    basisOf(degree, way[0] / length, way[1] / length, way[2] / length, p.basis);
    const int coefficients = (degree + 1) * (degree + 1);
    for (int i = 0; i < 3; ++i) {
      float colour = 0.5f;
      for (int k = 0; k < coefficients; ++k) {
        colour += p.basis[k] * values[kHarmonics + std::size_t(3 * k + i)];
      }
      splat.colour[i] = std::max(colour, 0.0f);
    }
    return true;
  }

  // Writes the gradient by a splat's values, from the sums over the picture's pixels.
  void backward(const float* values, const ProjectedSplat& p, const FitSplat& splat,
                const FitSums& sums, float* gradient) const {
    const int coefficients = (degree + 1) * (degree + 1);
    for (int k = 0; k < coefficients; ++k) {
      for (int i = 0; i < 3; ++i) {
        gradient[kHarmonics + std::size_t(3 * k + i)] =
            splat.colour[i] > 0 ? p.basis[k] * sums.colour[i] : 0.0f;
      }
    }
    gradient[kOpacity] = sums.p * (1 - p.opacity);  // d ln(opacity) / d logit

    // By the covariance S, where Q is its inverse: d(-d^T Q d / 2) = d^T Q dS Q d / 2.
    const float a = splat.a, b = splat.b, c = splat.c;
    const float xx = 0.5f * sums.pxx, xy = 0.5f * sums.pxy, yy = 0.5f * sums.pyy;
    const float left[2][2] = {{a * xx + b * xy, a * xy + b * yy},
                              {b * xx + c * xy, b * xy + c * yy}};
    float by_a = left[0][0] * a + left[0][1] * b, by_b = left[0][0] * b + left[0][1] * c,
          by_c = left[1][0] * b + left[1][1] * c;
    if (antialiased && p.det0 > 0) {  // d ln(kept) = (d ln(det0) - d ln(det)) / 2
      by_a += 0.5f * sums.p * (p.c0 / p.det0 - a);
      by_b += 0.5f * sums.p * (-p.b / p.det0 - b);
      by_c += 0.5f * sums.p * (p.a0 / p.det0 - c);
    }
    float by_m[2][3], by_rows[2][3] = {};
    for (int k = 0; k < 3; ++k) {
      by_m[0][k] = 2 * (by_a * p.m[0][k] + by_b * p.m[1][k]);
      by_m[1][k] = 2 * (by_b * p.m[0][k] + by_c * p.m[1][k]);
      gradient[kScale + std::size_t(k)] = by_m[0][k] * p.m[0][k] + by_m[1][k] * p.m[1][k];
    }
    float by_axes[3][3];
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) {
        by_axes[j][k] = p.scales[k] * (p.rows[0][j] * by_m[0][k] + p.rows[1][j] * by_m[1][k]);
        for (int i = 0; i < 2; ++i) by_rows[i][j] += by_m[i][k] * p.scales[k] * p.axes[j][k];
      }
    }
    rotationBackward(values + kRotation, by_axes, gradient + kRotation);

    // By the position in the camera's frame: through the centre, and through the Jacobian.
    const float by_centre[2] = {a * sums.px + b * sums.py, b * sums.px + c * sums.py};
    float by_at[3] = {};
    for (int i = 0; i < 2; ++i) {
      by_at[i] += by_centre[i] * p.jacobian[i][i];
      if (orthographic) continue;
      const float z = p.at[2];
      by_at[2] -= by_centre[i] * p.jacobian[i][i] * p.at[i] / z;
      float by_diagonal = 0, by_last = 0;
      for (int k = 0; k < 3; ++k) {
        by_diagonal += by_rows[i][k] * to_camera[i][k];
        by_last += by_rows[i][k] * to_camera[2][k];
      }
      by_at[2] -= by_diagonal * p.jacobian[i][i] / z;
      if (p.clamped[i]) {
        by_at[2] -= by_last * p.jacobian[i][2] / z;
      } else {
        by_at[2] -= 2 * by_last * p.jacobian[i][2] / z;
        by_at[i] -= by_last * p.jacobian[i][i] / z;
      }
    }
    for (int k = 0; k < 3; ++k) {
      gradient[kPosition + std::size_t(k)] =
          to_camera[0][k] * by_at[0] + to_camera[1][k] * by_at[1] + to_camera[2][k] * by_at[2];
    }
  }

  // The gradient by a quaternion that is normalised before it is used.
  static void rotationBackward(const float* q, const float (&by)[3][3], float* gradient) {
    const float over = 1 / std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    const float x = q[0] * over, y = q[1] * over, z = q[2] * over, w = q[3] * over;
    const float of_unit[4] = {
        2 * (y * (by[0][1] + by[1][0]) + z * (by[0][2] + by[2][0]) - 2 * x * (by[1][1] + by[2][2]) +
             w * (by[2][1] - by[1][2])),
        2 * (x * (by[0][1] + by[1][0]) + z * (by[1][2] + by[2][1]) - 2 * y * (by[0][0] + by[2][2]) +
             w * (by[0][2] - by[2][0])),
        2 * (x * (by[0][2] + by[2][0]) + y * (by[1][2] + by[2][1]) - 2 * z * (by[0][0] + by[1][1]) +
             w * (by[1][0] - by[0][1])),
        2 * (x * (by[2][1] - by[1][2]) + y * (by[0][2] - by[2][0]) + z * (by[1][0] - by[0][1]))};
    const float unit[4] = {x, y, z, w};
    float along = 0;
    for (int i = 0; i < 4; ++i) along += unit[i] * of_unit[i];
    for (int i = 0; i < 4; ++i) gradient[i] = over * (of_unit[i] - along * unit[i]);
  }
};

// A splat that the picture shows.
struct Refit::Seen {
  std::uint32_t splat;
  FitSums sums;
};

struct Refit::Work {
  cpu::FitTileFunction fit_tile;
  std::vector<std::vector<std::pair<std::uint32_t, FitSplat>>> chunks;
  std::vector<FitSplat> splats;
  std::vector<Seen> seen;
  std::vector<std::size_t> begins;  // of each tile's list in `listed`, and the end
  std::vector<std::uint32_t> listed;
  std::vector<FitSums> sums;
  std::vector<double> errors;
};

Refit::Refit(const SplatsView& start, std::shared_ptr<ThreadTeam> team,
             CpuRasterizer::Instructions instructions)
    : team_(std::move(team)),
      sh_degree_(start.arrays.sh_degree),
      antialiased_(start.model == Model::kEwaAntialiased),
      origin_(start.origin),
      count_(start.arrays.count),
      values_(kHarmonics + start.arrays.shStride()),
      work_(std::make_unique<Work>()) {
  start.check();
  if (!isEwa(start.model)) {
    throw std::invalid_argument("model: a refit draws by EWA, these splats are of model " +
                                nameOf(start.model));
  }
  const SplatArrays<const float>& from = start.arrays;
  now_.resize(values_ * count_);
  mean_.resize(now_.size());
  square_.resize(now_.size());
  steps_.resize(count_);
  work_->fit_tile = functionFor(instructions);
  for (std::size_t i = 0; i < count_; ++i) {
    if (!isUsable(from, i, from.positions + 3 * i)) {
      throw std::invalid_argument("splat " + std::to_string(i) + " has values that draw nothing");
    }
    float* const values = &now_[values_ * i];
    std::copy_n(from.positions + 3 * i, 3, values + kPosition);
    float largest = 1e-12f;
    for (std::size_t k = 0; k < 3; ++k) largest = std::max(largest, from.scales[3 * i + k]);
    for (std::size_t k = 0; k < 3; ++k) {  // a scale of 0 has no logarithm
      values[kScale + k] = std::log(std::max(from.scales[3 * i + k], 1e-4f * largest));
    }
    std::copy_n(from.orientations + 4 * i, 4, values + kRotation);
    const float least = 1 / (1 + std::exp(kMostLogit));
    const float opacity = std::clamp(from.opacities[i], least, 1 - least);
    values[kOpacity] = std::log(opacity / (1 - opacity));
    std::copy_n(from.sh + from.shStride() * i, from.shStride(), values + kHarmonics);
  }
}

Refit::~Refit() = default;

double Refit::draw(const Drawing& view, const float* target) {
  Work& work = *work_;
  const std::size_t chunks = (count_ + kChunk - 1) / kChunk;
  work.chunks.resize(chunks);
  inParts(team_.get(), chunks, [&](std::size_t number) {
    auto& chunk = work.chunks[number];
    chunk.clear();
    const std::size_t end = std::min(count_, (number + 1) * kChunk);
    ProjectedSplat projection;
    FitSplat splat;
    for (std::size_t i = number * kChunk; i < end; ++i) {
      if (view.project(&now_[values_ * i], projection, splat)) chunk.emplace_back(i, splat);
    }
  });
  work.splats.clear();
  work.seen.clear();
  const int across = (view.width + kTile - 1) / kTile, down = (view.height + kTile - 1) / kTile;
  work.begins.assign(std::size_t(across * down) + 1, 0);
  const auto overTiles = [across](const FitSplat& splat, const auto& each) {
    for (int row = splat.top / kTile; row <= (splat.bottom - 1) / kTile; ++row) {
      for (int column = splat.left / kTile; column <= (splat.right - 1) / kTile; ++column) {
        each(std::size_t(across * row + column));
      }
    }
  };
  for (const auto& chunk : work.chunks) {
    for (const auto& [index, splat] : chunk) {
      work.seen.push_back({index, {}});
      work.splats.push_back(splat);
      overTiles(splat, [&](std::size_t tile) { ++work.begins[tile + 1]; });
    }
  }
  for (std::size_t i = 1; i < work.begins.size(); ++i) work.begins[i] += work.begins[i - 1];
  work.listed.resize(work.begins.back());
  work.sums.resize(work.begins.back());
  std::vector<std::size_t> next(work.begins.begin(), work.begins.end() - 1);
  for (std::size_t i = 0; i < work.splats.size(); ++i) {
    overTiles(work.splats[i],
              [&](std::size_t tile) { work.listed[next[tile]++] = std::uint32_t(i); });
  }

  const float scale = 2.0f / (3.0f * float(view.width) * float(view.height));
  work.errors.assign(next.size(), 0);
  team_->run(static_cast<unsigned>(next.size()), [&](unsigned number, unsigned) {
    std::uint32_t* const listed = work.listed.data() + work.begins[number];
    const std::size_t count = work.begins[number + 1] - work.begins[number];
    std::sort(listed, listed + count, [&](std::uint32_t a, std::uint32_t b) {
      const float of_a = work.splats[a].depth, of_b = work.splats[b].depth;
      return of_a < of_b || (of_a == of_b && a < b);
    });
    const int row = int(number) / across, column = int(number) % across;
    FitTile tile;
    tile.listed = listed;
    tile.count = count;
    tile.splats = work.splats.data();
    tile.left = kTile * column, tile.top = kTile * row;
    tile.right = std::min(tile.left + kTile, view.width);
    tile.bottom = std::min(tile.top + kTile, view.height);
    tile.width = view.width;
    tile.target = target;
    tile.gradient_scale = scale;
    tile.sums = work.sums.data() + work.begins[number];
    work.errors[number] = work.fit_tile(tile);
  });
  for (std::size_t i = 0; i < work.listed.size(); ++i) {
    FitSums& sums = work.seen[work.listed[i]].sums;
    const FitSums& of_tile = work.sums[i];
    sums.p += of_tile.p, sums.px += of_tile.px, sums.py += of_tile.py;
    sums.pxx += of_tile.pxx, sums.pxy += of_tile.pxy, sums.pyy += of_tile.pyy;
    for (int k = 0; k < 3; ++k) sums.colour[k] += of_tile.colour[k];
  }
  double error = 0;
  for (const double of_tile : work.errors) error += of_tile;
  return error / (3.0 * view.width * view.height);
}

template <typename Use>
double Refit::forEachSeen(const SplatCamera& camera, const float* target, const Use& use) {
  const Drawing view(camera, origin_, antialiased_, sh_degree_);
  const double error = draw(view, target);
  const std::vector<Seen>& seen = work_->seen;
  const std::size_t chunks = (seen.size() + kChunk - 1) / kChunk;
  team_->run(static_cast<unsigned>(chunks), [&](unsigned number, unsigned) {
    const std::size_t end = std::min(seen.size(), (number + 1) * kChunk);
    ProjectedSplat projection;
    FitSplat splat;
    float gradient[kMostValues];
    for (std::size_t i = number * kChunk; i < end; ++i) {
      const std::size_t index = seen[i].splat;
      const float* const values = &now_[values_ * index];
      view.project(values, projection, splat);
      view.backward(values, projection, splat, seen[i].sums, gradient);
      use(index, gradient);
    }
  });
  return error;
}

double Refit::gradientAt(const SplatCamera& camera, const float* target,
                         std::vector<float>& gradient) {
  gradient.assign(values_ * count_, 0.0f);
  return forEachSeen(camera, target, [&](std::size_t index, const float* of_splat) {
    std::copy_n(of_splat, values_, &gradient[values_ * index]);
  });
}

double Refit::step(const SplatCamera& camera, const float* target, const RefitRates& rates) {
  constexpr float kMean = 0.9f, kSquare = 0.99f;  // share of its moments that Adam keeps
  float rate[kMostValues];
  std::fill_n(rate + kPosition, 3, rates.position);
  std::fill_n(rate + kScale, 3, rates.scale);
  std::fill_n(rate + kRotation, 4, rates.rotation);
  rate[kOpacity] = rates.opacity;
  std::fill_n(rate + kHarmonics, 3, rates.colour);
  std::fill(rate + kHarmonics + 3, rate + values_, rates.bands);
  return forEachSeen(camera, target, [&](std::size_t index, const float* gradient) {
    float* const now = &now_[values_ * index];
    float* const mean = &mean_[values_ * index];
    float* const square = &square_[values_ * index];
    if (steps_[index] < UINT16_MAX) ++steps_[index];
    const float steps = steps_[index];
    const float of_mean = 1 / (1 - std::pow(kMean, steps));
    const float of_square = 1 / (1 - std::pow(kSquare, steps));
    const float size = std::exp((now[kScale] + now[kScale + 1] + now[kScale + 2]) / 3);
    for (std::size_t k = 0; k < values_; ++k) {
      mean[k] = kMean * mean[k] + (1 - kMean) * gradient[k];
      square[k] = kSquare * square[k] + (1 - kSquare) * gradient[k] * gradient[k];
      const float unit = k < kScale ? size : 1.0f;
      now[k] -= unit * rate[k] * of_mean * mean[k] / (std::sqrt(of_square * square[k]) + 1e-15f);
    }
    now[kOpacity] = std::clamp(now[kOpacity], -kMostLogit, kMostLogit);
  });
}

Splats Refit::splats() const {
  Splats splats;
  splats.origin = origin_;
  splats.model = antialiased_ ? Model::kEwaAntialiased : Model::kEwa;
  const auto add = [](std::vector<float>& to, const float* from, std::size_t count) {
    to.insert(to.end(), from, from + count);
  };
  for (std::size_t i = 0; i < count_; ++i) {
    const float* const values = &now_[values_ * i];
    add(splats.positions, values + kPosition, 3);
    for (std::size_t k = 0; k < 3; ++k) splats.scales.push_back(std::exp(values[kScale + k]));
    const float* const q = values + kRotation;
    const float over = 1 / std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int k = 0; k < 4; ++k) splats.orientations.push_back(q[k] * over);
    splats.opacities.push_back(1 / (1 + std::exp(-values[kOpacity])));
    add(splats.sh, values + kHarmonics, values_ - kHarmonics);
  }
  return splats;
}

}  // namespace rosplat
