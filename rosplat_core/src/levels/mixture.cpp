#include "rosplat_core/levels/mixture.hpp"

#include <algorithm>
#include <cmath>

#include "rosplat_core/map/placement.hpp"

namespace rosplat {

namespace {

// What a picture's low-pass filter (0.3 px^2) adds to a splat's covariance where its cell is 8 px
// wide, in squared widths of the cell. The larger value that suits smaller cells would cost some dB
// at all others.
constexpr double kBlur = 0.3 / (8 * 8);

using Matrix = std::array<std::array<double, 3>, 3>;

// Returns the eigenvectors of a symmetric matrix as columns, and leaves its eigenvalues on the
// diagonal (Jacobi's rotations).
Matrix eigenvectors(Matrix& a) {
  Matrix v{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  for (int sweep = 0; sweep < 12; ++sweep) {
    const double off = a[0][1] * a[0][1] + a[0][2] * a[0][2] + a[1][2] * a[1][2];
    const double on = a[0][0] * a[0][0] + a[1][1] * a[1][1] + a[2][2] * a[2][2];
    if (off <= 1e-15 * on) break;  // far below the steps of a slot's rotation
    for (const auto& [p, q] : {std::pair{0, 1}, {0, 2}, {1, 2}}) {
      if (a[p][q] * a[p][q] <= 1e-16 * on) continue;
      const double theta = 0.5 * (a[q][q] - a[p][p]) / a[p][q];
      const double t = std::copysign(1 / (std::fabs(theta) + std::sqrt(theta * theta + 1)), theta);
      const double c = 1 / std::sqrt(t * t + 1), s = t * c;
      for (int k = 0; k < 3; ++k) {
        const double kp = a[k][p], kq = a[k][q];
        a[k][p] = c * kp - s * kq;
        a[k][q] = s * kp + c * kq;
      }
      for (int k = 0; k < 3; ++k) {
        const double pk = a[p][k], qk = a[q][k];
        a[p][k] = c * pk - s * qk;
        a[q][k] = s * pk + c * qk;
        const double kp = v[k][p], kq = v[k][q];
        v[k][p] = c * kp - s * kq;
        v[k][q] = s * kp + c * kq;
      }
    }
  }
  return v;
}

std::array<double, 6> covarianceOf(const Splat& splat) {
  const double x = splat.orientation[0], y = splat.orientation[1], z = splat.orientation[2],
               w = splat.orientation[3];
  const Matrix r{{{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                  {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                  {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}}};
  std::array<double, 3> v;
  for (std::size_t k = 0; k < 3; ++k) v[k] = double(splat.scale[k]) * splat.scale[k];
  const auto element = [&](int i, int j) {
    return r[i][0] * r[j][0] * v[0] + r[i][1] * r[j][1] * v[1] + r[i][2] * r[j][2] * v[2];
  };
  return {element(0, 0), element(0, 1), element(0, 2), element(1, 1), element(1, 2), element(2, 2)};
}

// Whether one time of `change` is after another. Its clock wraps around.
bool isLater(std::uint16_t a, std::uint16_t b) { return std::int16_t(a - b) > 0; }

}  // namespace

float nodeExtentOf(const PackedSlot& node) {
  const std::uint32_t* const slot = node.words.data();
  return extentOf(kMostNodeOpacity * slotOpacity(slot), largestScale(slot));
}

Mixture::Mixture(Cell cell, int sh_degree)
    : sh_degree_(sh_degree),
      coefficients_(harmonicsOf(sh_degree) - 3),
      corner_(cornerOf(cell)),
      size_(cellSize(levelOf(cell))) {}

// The root mean square, over all directions, of the area of one standard deviation. The low-pass
// filter is part of it: nothing covers less than the filter does.
double Mixture::areaOf(const Symmetric& s) const {
  const double blur = kBlur * size_ * size_, xx = s[0] + blur, yy = s[3] + blur, zz = s[5] + blur;
  const double minors = xx * yy - s[1] * s[1] + xx * zz - s[2] * s[2] + yy * zz - s[4] * s[4];
  return std::sqrt(std::max(minors, 0.0) / 3);
}

void Mixture::add(const PackedSlot& slot, float opacity_unit) {
  if ((slot.words[3] & 0xffffu) == 0) return;
  const Splat splat = unpackSlot(slot.words.data());
  const auto change = static_cast<std::uint16_t>(slot.words[kChangeWord] >> 16);
  if (count_++ == 0) {
    only_ = slot;
    only_unit_ = opacity_unit;
    change_ = change;
  } else if (isLater(change, change_)) {
    change_ = change;
  }
  const Symmetric covariance = covarianceOf(splat);
  const double mass = double(opacity_unit * splat.opacity) * areaOf(covariance);
  mass_ += mass;
  std::array<double, 3> at;
  for (std::size_t i = 0; i < 3; ++i) at[i] = splat.position[i] - corner_[i];
  for (std::size_t i = 0, k = 0; i < 3; ++i) {
    mean_[i] += mass * at[i];
    color_[i] += mass * splat.color[i];
    for (std::size_t j = i; j < 3; ++j, ++k) square_[k] += mass * (covariance[k] + at[i] * at[j]);
  }
  std::array<float, 45> sh;
  unpackHarmonics(slot.words.data(), sh_degree_, slot.bandWords(), sh.data());
  for (std::size_t i = 0; i < coefficients_; ++i) sh_[i] += float(mass) * sh[i];
}

PackedSlot Mixture::pack() const {
  PackedSlot node;
  if (empty()) return node;
  if (count_ == 1) {
    node = only_;
    const auto opacity =
        std::lrint(float(node.words[3] & 0xffffu) * (only_unit_ / kMostNodeOpacity));
    node.words[3] = (node.words[3] & 0xffff0000u) | std::uint32_t(opacity);
    return node;
  }
  Splat splat;
  std::array<double, 3> mean;
  for (std::size_t i = 0; i < 3; ++i) {
    mean[i] = mean_[i] / mass_;
    // Rounding must not move the mean out of its cell.
    const float least = float(corner_[i]), end = float(corner_[i] + size_);
    splat.position[i] = std::clamp(float(corner_[i] + mean[i]), least, std::nextafter(end, least));
    splat.color[i] = float(color_[i] / mass_);
  }
  Symmetric covariance;
  for (std::size_t i = 0, k = 0; i < 3; ++i) {
    for (std::size_t j = i; j < 3; ++j, ++k) covariance[k] = square_[k] / mass_ - mean[i] * mean[j];
  }
  const auto& [xx, xy, xz, yy, yz, zz] = covariance;
  Matrix matrix{{{xx, xy, xz}, {xy, yy, yz}, {xz, yz, zz}}};
  // A product of rotations made the vectors, so they are right-handed.
  const Matrix v = eigenvectors(matrix);
  const auto q = quaternionOf(
      {v[0][0], v[0][1], v[0][2], v[1][0], v[1][1], v[1][2], v[2][0], v[2][1], v[2][2]});
  std::copy(q.begin(), q.end(), splat.orientation.begin());
  for (std::size_t i = 0; i < 3; ++i)
    splat.scale[i] = float(std::sqrt(std::max(matrix[i][i], 0.0)));
  constexpr float kLeastOpacity = 1 / 65535.0f;  // the least above 0 that a slot can hold
  splat.opacity = std::max(float(mass_ / areaOf(covariance)) / kMostNodeOpacity, kLeastOpacity);

  std::array<float, 45> sh;
  for (std::size_t i = 0; i < coefficients_; ++i) sh[i] = sh_[i] / float(mass_);
  std::array<std::uint32_t*, kMaxShDegree + 1> bands{};
  for (std::size_t band = 1; band < bands.size(); ++band) bands[band] = node.bands[band].data();
  packSlot(splat, sh.data(), sh_degree_, node.words.data(), bands);
  node.words[kChangeWord] |= std::uint32_t(change_) << 16;
  return node;
}

}  // namespace rosplat
