// How it works. One source, compiled for plain C++, AVX2 and AVX-512 (simd.hpp): kLanes splats or
// pixels at a time. In the order in which CpuRasterizer calls them:
// 1. cull: which slots of a page may show, with the sorters' test (depth_order.hpp).
// 2. hide: leaves out what the pyramid of depths says is behind nearer slices.
// 3. project: an EWA splat (Zwicker et al. 2001, as in Kerbl et al. 2023) by the projection's
//    Jacobian, a pinhole's or a lens's, + 0.3 px^2, to an ellipse; a splat trained along rays, or a
//    disc, to a conic (views/conic.hpp); harmonics to a colour; the tiles that the outline of alpha
//    = 1/255 touches, row by row.
// 4. blend, pick, contribute: a tile's list front to back, alpha = 2^(peak - u^2 - v^2) by four
//    squarings, until no pixel lets more than 1e-4 through.
// What is left out is below 1/255 or behind 1e-4; the rest is exact but for the rounding of
// float32.

#include "raster/kernels.hpp"

#include "raster/simd.hpp"
#include "rosplat_core/views/conic.hpp"

// For what ellipses and conics both use in their loops: a call would spill the loops' registers.
#define ROSPLAT_INLINED __attribute__((always_inline)) inline

namespace rosplat::cpu::ROSPLAT_TARGET {

namespace {

constexpr int kSlots = kPageSlots;
constexpr float kBallSigmas = 1.74017f;  // radius of a ball: where a splat falls to kBallEdge
constexpr float kBallEnd = -2.18442457f / kSquared;  // log2(kBallEdge) / kSquared
constexpr float kCutoffEnd = kLog2Cutoff / kSquared;
constexpr float kLog2 = 0.69314718f;

template <typename T>
T least(T a, T b) {
  return a < b ? a : b;
}
template <typename T>
T most(T a, T b) {
  return a > b ? a : b;
}

// Loads values of slots, by the slots' places in a page.
class Places {
 public:
  Places(const std::uint16_t* places, int lanes)
      : index_(__builtin_convertvector(load<Halves>(places), Ints)),
        first_(places[0]),
        dense_(lanes == kLanes && places[kLanes - 1] - places[0] == kLanes - 1) {}

  template <typename T>
  auto of(const T* values) const {
    using Vector = decltype(gather(values, index_));
    return dense_ ? load<Vector>(values + first_) : gather(values, index_);
  }
  int operator[](int lane) const { return index_[lane]; }

 private:
  Ints index_;
  int first_;
  bool dense_;
};

struct Vec2 {
  Floats x, y;
};
struct Vec3 {
  Floats x, y, z;
};
Vec3 operator*(Floats s, const Vec3& v) { return {s * v.x, s * v.y, s * v.z}; }
Vec3 operator+(const Vec3& a, const Vec3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vec3 operator*(const Vec3& a, const Vec3& b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
Floats dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vec3 select(Ints where, const Vec3& a, const Vec3& b) {
  return {where ? a.x : b.x, where ? a.y : b.y, where ? a.z : b.z};
}

// Rounds operation by operation as the sorters do: see depth_order.hpp.
Floats transform(const float* row, const Vec3& p) {
  return ((row[0] * p.x + row[1] * p.y) + row[2] * p.z) + row[3];
}

// The width in the picture, at the cell's nearest point, of the cell around a position [px].
Floats errorOf(const CutView& cut, const float* eye_at, const Vec3& p, Floats cell) {
  const auto outside = [&](Floats x, float eye) {
    const Floats least = floor(x / cell) * cell;
    return max(max(least - eye, eye - (least + cell)), Floats{});
  };
  if (cut.orthographic) return cut.focal * cell;
  const Vec3 away = {outside(p.x, eye_at[0]), outside(p.y, eye_at[1]), outside(p.z, eye_at[2])};
  return cut.focal * cell / max(sqrt(dot(away, away)), all(1e-6f));
}

// The shares of slots or nodes that a cut draws: see cut.hpp.
ROSPLAT_INLINED Floats shareOf(const CutView& cut, const float* eye, const Vec3& p, Floats parent,
                               float own) {
  const auto rise = [&](Floats error) {
    const Floats t = clamp((error - cut.from) * cut.over_span, Floats{}, all(1.0f));
    return t * t * (3.0f - 2.0f * t);
  };
  const Floats coarser = rise(errorOf(cut, eye, p, parent));
  return own > 0.0f ? coarser - rise(errorOf(cut, eye, p, all(own))) : coarser;
}

// The depth that counts of a point in the frame of a face of a lens's picture.
Floats depthThrough(const CullView& view, const Vec3& p) {
  const float* const axis = view.axis;
  if (view.by_distance) return sqrt(dot(p, p));
  return axis[0] * p.x + axis[1] * p.y + axis[2] * p.z;
}

enum class Seen { kPinhole, kFaceOfLens, kInCone };

template <Seen kAs>
std::size_t cullAs(const CullView& given, const PageSlots& page, Candidate* candidates) {
  const CullView view = given;  // copies that no store below can alias
  const GroupView group = *page.group;
  Candidate* out = candidates;
  for (int i = 0; i < kSlots; i += kLanes) {
    const Vec3 p = {load(page.position[0] + i), load(page.position[1] + i),
                    load(page.position[2] + i)};
    const Floats extent = load(page.extent + i);
    const Floats x = transform(group.to_camera[0], p);
    const Floats y = transform(group.to_camera[1], p);
    const Floats z = transform(group.to_camera[2], p);
    const Floats w = view.orthographic ? all(1.0f) : z;
    const Floats depth = kAs == Seen::kPinhole ? z : depthThrough(view, {x, y, z});
    Ints seen = (extent >= 0.0f) & (depth > view.near_clip) & (depth < view.far_clip);
    if (kAs == Seen::kInCone) {  // cos(a + e / d) >= cos(a) - e / d
      seen &= z + view.extent_scale * extent >= view.cone * sqrt(x * x + y * y + z * z);
    } else {
      seen &= abs(view.fx * x + view.offset_x * w) <= view.half_width * w + view.slope_x * extent;
      seen &= abs(view.fy * y + view.offset_y * w) <= view.half_height * w + view.slope_y * extent;
    }
    if (view.clip_to_box) {
      for (int i = 0; i < 3; ++i) seen &= abs(transform(group.to_box[i], p)) <= view.half_box[i];
    }
    if (page.parents && any(seen)) {
      seen &= shareOf(view.cut, group.eye, p, load(page.parents + i), page.own_cell) > 0.0f;
    }
    const Ints bits = (Ints)(depth + 0.0f);  // the sum turns -0 into 0
    const Ints keys = bits ^ ((bits >> 31) | INT32_MIN);
    for (int lane = 0; lane < kLanes; ++lane) {
      *out = {std::uint32_t(keys[lane]), page.first_index + std::uint32_t(i + lane)};
      out -= seen[lane];
    }
  }
  return std::size_t(out - candidates);
}

std::size_t cull(const CullView& view, const PageSlots& page, Candidate* candidates) {
  if (view.in_cone) return cullAs<Seen::kInCone>(view, page, candidates);
  return view.through_lens ? cullAs<Seen::kFaceOfLens>(view, page, candidates)
                           : cullAs<Seen::kPinhole>(view, page, candidates);
}

Floats scaleOf(Words code) {
  const Floats scale = exp2(-40.0f + 64.0f / 65534.0f * (toFloats((Ints)code) - 1.0f));
  return code == 0u ? all(0.0f) : scale;
}

Floats signedBits(Words word, int shift, int bits) {
  return toFloats((Ints)(word << (32 - shift - bits)) >> (32 - bits));
}

// Columns of a slot's rotation matrix.
ROSPLAT_INLINED void orientationOf(Words low, Words high, Vec3* columns) {
  constexpr float kStep = 0.70710678118654752f / 16383.0f;
  const Floats a = signedBits(low, 2, 15) * kStep, b = signedBits(low, 17, 15) * kStep,
               c = signedBits(high, 0, 15) * kStep;
  const Floats d = sqrt(max(1.0f - (a * a + b * b + c * c), all(0.0f)));
  const Ints missing = (Ints)(low & 3u);
  Floats x = missing == 0 ? d : a;
  Floats y = missing == 0 ? a : missing == 1 ? d : b;
  Floats z = missing <= 1 ? b : missing == 2 ? d : c;
  Floats w = missing == 3 ? d : c;
  const Floats one = 1.0f / sqrt(x * x + y * y + z * z + w * w);
  x *= one, y *= one, z *= one, w *= one;
  const Floats xx = 2.0f * x * x, yy = 2.0f * y * y, zz = 2.0f * z * z, xy = 2.0f * x * y,
               xz = 2.0f * x * z, yz = 2.0f * y * z, wx = 2.0f * w * x, wy = 2.0f * w * y,
               wz = 2.0f * w * z;
  columns[0] = {1.0f - yy - zz, xy + wz, xz - wy};
  columns[1] = {xy - wz, 1.0f - xx - zz, yz + wx};
  columns[2] = {xz + wy, yz - wx, 1.0f - xx - yy};
}

// Google's Turbo, blue to red over 0 to 1 (polynomial of Mikhailov 2019).
Vec3 turbo(Floats t) {
  constexpr float kPolynomials[3][6] = {
      {0.13572138f, 4.61539260f, -42.66032258f, 132.13108234f, -152.94239396f, 59.28637943f},
      {0.09140261f, 2.19418839f, 4.84296658f, -14.18503333f, 4.27729857f, 2.82956604f},
      {0.10667330f, 12.64194608f, -60.58204836f, 110.36276771f, -89.90310912f, 27.34824973f}};
  t = clamp(t, all(0.0f), all(1.0f));
  Vec3 c;
  Floats* const channels[3] = {&c.x, &c.y, &c.z};
  for (int i = 0; i < 3; ++i) {
    Floats v = all(kPolynomials[i][5]);
    for (int k = 4; k >= 0; --k) v = v * t + kPolynomials[i][k];
    *channels[i] = clamp(v, all(0.0f), all(1.0f));
  }
  return c;
}

// Hues are a golden angle apart; tones take turns: light, medium, dark.
Vec3 categoryColour(Ints category) {
  const Words number = (Words)category;
  const Floats hue = toFloats((Ints)(number * 2654435769u >> 8)) * (6.0f / 16777216.0f);
  const Words tone = number % 3u;
  const Floats saturation = tone == 0u ? all(0.65f) : tone == 1u ? all(0.85f) : all(0.8f);
  const Floats value = tone == 0u ? all(1.0f) : tone == 1u ? all(0.7f) : all(0.5f);
  const auto channel = [&](float offset) {
    Floats at = hue + offset;
    at = at >= 6.0f ? at - 6.0f : at;
    const Floats pure = clamp(abs(at - 3.0f) - 1.0f, all(0.0f), all(1.0f));
    return value * (1.0f + saturation * (pure - 1.0f));
  };
  return {channel(0), channel(4), channel(2)};
}

Vec3 channelColour(const ProjectView& view, Floats value) {
  constexpr int kExponent = 0x7f800000;
  const Ints none = ((Ints)value & kExponent) == kExponent;  // not finite: the slot has no value
  Vec3 c;
  if (view.channel_colours == kCategories) {
    constexpr float kMost = 1 << 30;
    c = categoryColour(
        toInts(floor(clamp(none ? Floats{} : value, all(-kMost), all(kMost)) + 0.5f)));
  } else {
    const Floats above =
        clamp(value, all(view.channel_least), all(view.channel_most)) - view.channel_least;
    c = turbo(above * view.channel_per_range);
  }
  return select(view.channel_colours == kNoColours ? ~Ints{} : none,
                {all(0.5f), all(0.5f), all(0.5f)}, c);
}

// Clamps to 0 from below. Brighter than white is allowed, up to the largest half float.
Floats radiance(Floats c) { return c > 0.0f ? min(c, all(65504.0f)) : all(0.0f); }

// Adds a band of harmonics, in the slot's unit: a coefficient is a fraction of that, -1 to 1.
template <int kCount>
void addBand(Vec3& c, const Words* band, const Floats (&basis)[kCount]) {
  for (int k = 0; k < kCount; ++k) {
    const Words word = band[k];
    c.x += basis[k] * (signedBits(word, 0, 11) * (1.0f / 1023.0f));
    c.y += basis[k] * (signedBits(word, 11, 11) * (1.0f / 1023.0f));
    c.z += basis[k] * (signedBits(word, 22, 10) * (1.0f / 511.0f));
  }
}

// Loads slots' appearances as far as they are wanted.
class Appearance {
 public:
  Appearance(const PageSlots& page, const Places& places) {
    for (int lane = 0; lane < kLanes; ++lane) {
      from_[lane] = page.appearances + places[lane] * page.appearance_words;
    }
    load(kColour);
  }
  Words operator[](int word) const { return words_[word]; }
  // The words of a band, which begins at `first`.
  const Words* band(int first, int count) {
    load(first + count);
    return words_ + first;
  }

 private:
  static constexpr int kColour = 6;  // words before the bands

  void load(int count) {
    for (; loaded_ < count; loaded_ += 4) loadFour(from_, loaded_, words_ + loaded_);
  }

  const std::uint32_t* from_[kLanes];
  Words words_[kMostAppearanceWords];
  int loaded_ = 0;
};

// Spherical harmonics in the group's frame (Kerbl et al. 2023).
ROSPLAT_INLINED Vec3 trainedColour(const ProjectView& view, const PageSlots& page,
                                   Appearance& appearance, const Vec3& direction) {
  const auto wanted = [&](int band) {
    return page.bands[band] > 0 && band <= view.sh_degree &&
           (view.only_band < 0 || band == view.only_band);
  };
  const Floats x = direction.x, y = direction.y, z = direction.z;
  const Floats xx = x * x, yy = y * y, zz = z * z;
  Vec3 c = {};
  if (wanted(1)) {
    constexpr float k = 0.4886025119029199f;
    addBand<3>(c, appearance.band(page.bands[1], 3), {-k * y, k * z, -k * x});
  }
  if (wanted(2)) {
    constexpr float k = 1.0925484305920792f;
    addBand<5>(c, appearance.band(page.bands[2], 5),
               {k * x * y, -k * y * z, 0.31539156525252005f * (2.0f * zz - xx - yy), -k * x * z,
                0.5462742152960396f * (xx - yy)});
  }
  if (wanted(3)) {
    addBand<7>(c, appearance.band(page.bands[3], 7),
               {-0.5900435899266435f * y * (3.0f * xx - yy), 2.890611442640554f * x * y * z,
                -0.4570457994644658f * y * (4.0f * zz - xx - yy),
                0.3731763325901154f * z * (2.0f * zz - 3.0f * xx - 3.0f * yy),
                -0.4570457994644658f * x * (4.0f * zz - xx - yy),
                1.445305721320277f * z * (xx - yy), -0.5900435899266435f * x * (xx - 3.0f * yy)});
  }
  c = halfToFloats(appearance[3] >> 16) * c;
  if (view.only_band <= 0) {
    c = c + all(0.28209479177387814f) * Vec3{halfToFloats(appearance[4] & 0xffffu),
                                             halfToFloats(appearance[4] >> 16),
                                             halfToFloats(appearance[5] & 0xffffu)};
  }
  return {radiance(c.x + 0.5f), radiance(c.y + 0.5f), radiance(c.z + 0.5f)};
}

ROSPLAT_INLINED Vec3 colourOf(const ProjectView& view, const GroupView& group,
                              const PageSlots& page, Appearance& appearance, const Places& places,
                              const Vec3& mean, Floats depth, const Vec3& scale,
                              const Vec3* orientation, Floats opacity) {
  if (view.mode == DrawMode::kOpacity) return turbo(opacity);
  if (view.mode == DrawMode::kDepth) {
    const float range = view.depth_range.most - view.depth_range.least;
    return turbo(1.0f - (depth - view.depth_range.least) / most(range, 1e-6f));
  }
  if (view.mode == DrawMode::kAge) {
    Floats ticks = view.now - toFloats((Ints)(appearance[5] >> 16));
    ticks = ticks < 0.0f ? ticks + 65536.0f : ticks;
    return turbo(1.0f - 0.25f * ticks / view.age_range);
  }
  if (view.mode == DrawMode::kChannel) return channelColour(view, places.of(page.channel));
  Vec3 direction = {all(group.eye[0]), all(group.eye[1]), all(group.eye[2])};
  if (!view.orthographic) {
    direction = mean + all(-1.0f) * direction;
    direction = (1.0f / sqrt(dot(direction, direction))) * direction;
  }
  if (view.mode == DrawMode::kNormals) {
    const Vec3 normal = select((scale.x <= scale.y) & (scale.x <= scale.z), orientation[0],
                               select(scale.y <= scale.z, orientation[1], orientation[2]));
    const Floats half = dot(normal, direction) > 0.0f ? all(-0.5f) : all(0.5f);
    const Vec3 c = half * normal;
    const auto inMap = [&](const float* row) { return row[0] * c.x + row[1] * c.y + row[2] * c.z; };
    return {0.5f + inMap(group.to_box[0]), 0.5f + inMap(group.to_box[1]),
            0.5f + inMap(group.to_box[2])};
  }
  return trainedColour(view, page, appearance, direction);
}

// Pixels whose centres are in a range: the first, and one past the last.
struct PixelSpan {
  Ints first, last;
};
PixelSpan pixelsIn(Floats from, Floats to, int pixels) {
  const Floats slack = 0.05f + 1e-5f * (to - from);  // for rounding
  const Floats most = all(float(pixels));  // clamps before the conversion, lest that overflow
  // ceil(from - 0.5) and floor(to - 0.5) + 1, by truncation of numbers that aren't negative.
  const Ints first = toInts(clamp(from + 0.5f - slack, all(0.0f), most));
  const Ints last = toInts(clamp(to + 0.5f + slack, all(0.0f), most));
  return {first, last};
}

// The tiles that hold a span of pixels: the first, and one past the last.
PixelSpan tilesOf(const PixelSpan& pixels) {
  const Ints none = pixels.first >= pixels.last;
  return {none ? Ints{} : pixels.first >> 4, none ? Ints{} : (pixels.last + (kTile - 1)) >> 4};
}
static_assert(kTile == 1 << 4);

// Clamped to the depth buffer's far plane: no object stands beyond that.
Floats windowDepthOf(const ProjectView& view, Floats z) {
  const Floats w = view.orthographic ? all(1.0f) : z;
  return 0.5f * min((view.ndc_scale * z + view.ndc_offset) / w, all(1.0f)) + 0.5f;
}

// Bounds a splat as cull() and the sorters do.
std::size_t hide(const CullView& view, const ProjectView& project_view, const Pyramid& pyramid,
                 const PageSlots& page, std::uint16_t* places_of, std::uint16_t* numbers,
                 std::size_t count) {
  constexpr float kMargin =
      2.6f;  // for the low-pass filter or spot, as kMarginPixels, and for rounding [px]
  const GroupView group = *page.group;  // a copy that no store below can alias
  std::size_t n = 0;
  for (std::size_t first = 0; first < count; first += kLanes) {
    const int lanes = int(least(std::size_t(kLanes), count - first));
    const Places places(places_of + first, lanes);
    const Vec3 mean = {places.of(page.position[0]), places.of(page.position[1]),
                       places.of(page.position[2])};
    const Floats extent = places.of(page.extent);
    const Floats z = transform(group.to_camera[2], mean);
    const Floats over_w = view.orthographic ? all(1.0f) : 1.0f / z;
    const auto tilesAlong = [&](int axis, float focal, float centre, float slope, int tiles) {
      const Floats at = focal * transform(group.to_camera[axis], mean) * over_w + centre;
      const Floats reach = slope * extent * over_w + kMargin;
      const Floats last = all(float(tiles - 1));
      // If float32 can't hold the position (NaN): from the first tile to the last.
      return PixelSpan{toInts(min(max((at - reach) * (1.0f / kTile), Floats{}), last)),
                       toInts(max(min((at + reach) * (1.0f / kTile), last), Floats{}))};
    };
    const PixelSpan columns =
        tilesAlong(0, project_view.fx, project_view.cx, view.slope_x, pyramid.across);
    const PixelSpan rows =
        tilesAlong(1, project_view.fy, project_view.cy, view.slope_y, pyramid.down);
    // The pyramid's level where columns and rows are 2x2 cells at most.
    const Ints span = max(columns.last - columns.first, rows.last - rows.first);
    const Ints level = span < 2 ? Ints{} : ((Ints)toFloats(span) >> 23) - 126;
    const Ints begin = (Ints)gather((const std::uint32_t*)pyramid.begins, level);
    const Ints width = (Ints)gather((const std::uint32_t*)pyramid.widths, level);
    const Ints top = begin + (rows.first >> level) * width;
    const Ints bottom = begin + (rows.last >> level) * width;
    const Ints left = columns.first >> level, right = columns.last >> level;
    const Floats open =
        max(max(gather(pyramid.open, top + left), gather(pyramid.open, top + right)),
            max(gather(pyramid.open, bottom + left), gather(pyramid.open, bottom + right)));
    const Ints seen = windowDepthOf(project_view, z) <= open;
    for (int i = 0; i < lanes; ++i) {
      const std::uint16_t place = places_of[first + std::size_t(i)];
      numbers[n] = std::uint16_t(first + std::size_t(i));
      places_of[n] = place;
      n -= std::size_t(std::ptrdiff_t(seen[i]));
    }
  }
  return n;
}

// An ellipse in the picture: where a splat's alpha is at least 1/255.
struct Ellipse {
  Floats x, y;     // centre [px]
  Floats a, b, c;  // xx, xy, yy of its covariance, and the determinant [px^2]
  Floats determinant;
};

// A rectangle in the picture. [px]
struct Box {
  Floats left, right, top, bottom;
};

// The outline of a conic around a point; an ellipse around the whole picture where it is open, and
// `box` is then what it reaches.
Ellipse ellipseOf(const ProjectView& view, const Conic<Floats>& conic, Floats cut2, Floats x,
                  Floats y, Vec2 spot, Box& box) {
  const Outline<Floats> o = outlineOf(conic, cut2);
  Ellipse e = {x + o.x, y + o.y, o.xx, o.xy, o.yy, o.determinant};
  if (view.model == Model::kDisc) {  // with room for the spot
    const Floats dx = spot.x - e.x, dy = spot.y - e.y;
    const Floats reach = sqrt(cut2 * (1.0f / kSpot)) + sqrt(dx * dx + dy * dy);
    const Floats more = reach * reach / cut2;
    e.determinant += more * (e.a + e.c + more);
    e.a += more;
    e.c += more;
  }
  const float size = view.width + view.height;
  const Ints closed = (o.w > kLeastAhead) & (cut2 * (e.a + e.c) < 1e4f * size * size);
  const Floats around = size * size / cut2;
  box = {e.x - sqrt(cut2 * e.a), e.x + sqrt(cut2 * e.a), e.y - sqrt(cut2 * e.c),
         e.y + sqrt(cut2 * e.c)};
  if (any(~closed)) {
    const Reach<Floats> reach = reachOf(conic, cut2, [](Floats v) { return sqrt(v); });
    const Floats of_spot = sqrt(cut2 * (1.0f / kSpot));
    const bool has_spot = view.model == Model::kDisc;
    // As far as the picture shows none of the mirror image.
    const auto beyond = [](Floats at, Floats mirror, float pixels) {
      return ((mirror > 0.0f) & (at + mirror > pixels)) | ((mirror < 0.0f) & (at + mirror < 0.0f));
    };
    const Ints bounded =
        beyond(x, reach.mirror_x, view.width) | beyond(y, reach.mirror_y, view.height);
    const auto lower = [&](Floats at, Floats in_spot, Floats of_closed) {
      const Floats least = has_spot ? min(at, in_spot - of_spot) : at;
      return closed ? of_closed : bounded ? max(least, all(-size)) : all(-size);
    };
    const auto upper = [&](Floats at, Floats in_spot, Floats of_closed) {
      const Floats most = has_spot ? max(at, in_spot + of_spot) : at;
      return closed ? of_closed : bounded ? min(most, all(2.0f * size)) : all(2.0f * size);
    };
    box = {lower(x - reach.left, spot.x, box.left), upper(x + reach.right, spot.x, box.right),
           lower(y - reach.up, spot.y, box.top), upper(y + reach.down, spot.y, box.bottom)};
  }
  return {closed ? e.x : all(0.5f * view.width),
          closed ? e.y : all(0.5f * view.height),
          closed ? e.a : around,
          closed ? e.b : Floats{},
          closed ? e.c : around,
          closed ? e.determinant : around * around};
}

// A splat beside or behind the camera of a face of a lens's picture: its conic
// in the frame that looks along its mean, as linear forms of the face's rays.
struct Aside {
  Vec3 u, v, along;  // of the ray x right, y down, z forward
  Floats distance, nearness;
  Ints seen;  // whether its outline reaches what is in front of the camera
};

Aside asideOf(const Vec3& p, const Vec3& scale, const Vec3 (&axes)[3], Floats sigmas) {
  const auto cross = [](const Vec3& a, const Vec3& b) {
    return Vec3{a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  };
  Aside aside;
  aside.distance = sqrt(dot(p, p));
  const Floats over = 1.0f / max(aside.distance, all(1e-20f));
  const Vec3 ahead = over * p;
  const Floats flat = 1.0f / max(sqrt(ahead.x * ahead.x + ahead.y * ahead.y), all(1e-6f));
  const Vec3 right = {-ahead.y * flat, ahead.x * flat, Floats{}}, down = cross(ahead, right);
  Rows<Floats> rows;
  const Floats scales[3] = {over * scale.x, over * scale.y, over * scale.z};
  Floats reach = {};
  for (int k = 0; k < 3; ++k) {
    rows.right[k] = scales[k] * dot(right, axes[k]);
    rows.down[k] = scales[k] * dot(down, axes[k]);
    rows.ahead[k] = scales[k] * dot(ahead, axes[k]);
    reach += scales[k] * scales[k] * axes[k].z * axes[k].z;
  }
  aside.seen = ahead.z + sigmas * sqrt(reach) > 0.0f;
  const Conic<Floats> c = conicOf(rows);
  // Cholesky of the inverse: n = u^2 + v^2.
  const Floats per_sigma = all(kHalfLog2 / 4.0f);
  const Floats xx = max(c.xx, all(1e-20f)), left = 1.0f / sqrt(xx);
  const Floats rest = sqrt(xx / max(c.determinant, all(1e-30f)));
  aside.u = (per_sigma * left) * right;
  aside.v = (per_sigma * rest) * (down + (-c.xy / xx) * right);
  aside.along = ahead + c.tilt[0] * right + c.tilt[1] * down;
  aside.nearness = c.nearness;
  return aside;
}

// Where a lens images points, and the derivatives by the points.
struct Imaged {
  Floats x, y;      // [px]
  Vec3 of_x, of_y;  // [px/m]
  Ints met;         // whether the lens images the point at all
};

ROSPLAT_INLINED Imaged imagedBy(const ProjectView& view, const Vec3& p) {
  const LensCurve& lens = view.lens;
  const Floats over = 1.0f / max(sqrt(dot(p, p)), all(1e-20f));
  const Vec3 n = over * p;
  const Floats beside = n.x * n.x + n.y * n.y;  // next to the axis, 1 - n.z would cancel
  const Floats w = 0.5f * (n.z > 0.0f ? beside / (1.0f + n.z) : 1.0f - n.z);
  const Floats at = w * lens.parts_per_end;
  const Ints part = toInts(min(at, all(float(lens.parts - 1))));
  const Floats t = at - toFloats(part);
  const auto coefficient = [&](int k) { return gather(lens.cubics + k, 4 * part); };
  const Floats c1 = coefficient(1), c2 = coefficient(2), c3 = coefficient(3);
  const Floats g = coefficient(0) + t * (c1 + t * (c2 + t * c3));
  const Floats slope = (c1 + t * (2.0f * c2 + t * (3.0f * c3))) * lens.parts_per_end;
  // Of g n.x: (g e_x - n.x (g n + g' (e_z - n.z n) / 2)) / |p|, as dw = -dn.z / 2.
  const Floats half = 0.5f * slope, along = g - half * n.z;
  const Vec3 bend = {along * n.x, along * n.y, along * n.z + half};
  const Floats fx = view.fx * over, fy = view.fy * over;
  return {view.fx * g * n.x + view.cx, view.fy * g * n.y + view.cy,
          fx * Vec3{g - n.x * bend.x, -n.x * bend.y, -n.x * bend.z},
          fy * Vec3{-n.y * bend.x, g - n.y * bend.y, -n.y * bend.z}, w <= lens.end};
}

// kLens: ellipses in a lens's picture. kPlanes: ellipses that have planes.
template <bool kConic, bool kLens, bool kPlanes>
std::size_t projectAs(const ProjectView& given, const PageSlots& page,
                      const std::uint16_t* places_of, std::size_t count, Record* records,
                      RayShape* shapes, Footprint* footprints, std::uint16_t* kept) {
  const ProjectView view = given;  // copies that no store below can alias
  const GroupView group = *page.group;
  const bool balls = view.mode == DrawMode::kFlatBall || view.mode == DrawMode::kGaussianBall;
  const float ball_share = view.mode == DrawMode::kFlatBall       ? kFlatBallShare
                           : view.mode == DrawMode::kGaussianBall ? kGaussianBallShare
                                                                  : 0.0f;
  std::size_t n = 0;
  for (std::size_t first_of = 0; first_of < count; first_of += kLanes) {
    const int lanes = int(least(std::size_t(kLanes), count - first_of));
    const Places places(places_of + first_of, lanes);
    // Fetches the next vector's appearances: rows far apart, which no processor foresees.
    for (std::size_t i = first_of + kLanes; i < least(first_of + 2 * kLanes, count); ++i) {
      const std::uint32_t* const next = page.appearances + places_of[i] * page.appearance_words;
      __builtin_prefetch(next);
      __builtin_prefetch(next + page.appearance_words - 1);
      if (page.appearance_words > 17) __builtin_prefetch(next + 16);
    }
    const Vec3 mean = {places.of(page.position[0]), places.of(page.position[1]),
                       places.of(page.position[2])};
    Appearance appearance(page, places);

    const Vec3 p = {transform(group.to_camera[0], mean), transform(group.to_camera[1], mean),
                    transform(group.to_camera[2], mean)};
    const Floats trained_opacity = toFloats((Ints)(appearance[0] & 0xffffu)) * page.opacity_unit;
    const Floats share =
        page.parents ? shareOf(view.cut, group.eye, mean, places.of(page.parents), page.own_cell)
                     : all(1.0f);
    Floats opacity = view.opacity * trained_opacity;
    if (view.near_fade > 0.0f) {
      const Floats from_eye = view.through_lens ? sqrt(dot(p, p)) : p.z;
      opacity *= min((from_eye - view.near_clip) / view.near_fade, all(1.0f));
    }

    // Rows of the projection's Jacobian: {jx, 0, jxz} and {0, jy, jyz}. Tangents are clamped as in
    // training.
    Floats jx, jxz, jy, jyz, x, y;
    Imaged imaged;
    if constexpr (kLens) {
      imaged = imagedBy(view, p);
      x = imaged.x, y = imaged.y;
    } else if (view.orthographic) {
      jx = all(view.fx), jy = all(view.fy), jxz = jyz = Floats{};
      x = view.fx * p.x + view.cx, y = view.fy * p.y + view.cy;
    } else {
      const Floats over_z = 1.0f / p.z;
      const Floats tx = p.x * over_z, ty = p.y * over_z;
      jx = view.fx * over_z, jy = view.fy * over_z;
      if constexpr (kConic) {
        jxz = -jx * tx, jyz = -jy * ty;
      } else {
        jxz = -jx * clamp(tx, all(view.least_tangent[0]), all(view.most_tangent[0]));
        jyz = -jy * clamp(ty, all(view.least_tangent[1]), all(view.most_tangent[1]));
      }
      x = view.fx * tx + view.cx, y = view.fy * ty + view.cy;
    }

    // Covariance in the picture: rows of J W R S times their transposes.
    Vec3 scale = {scaleOf(appearance[0] >> 16), scaleOf(appearance[1] & 0xffffu),
                  scaleOf(appearance[1] >> 16)};
    scale = all(view.scale) * scale;
    if (kConic && view.model == Model::kDisc && page.own_cell == 0.0f) scale.z = Floats{};
    if (view.mode == DrawMode::kBillboard) {
      scale.x = scale.y = scale.z = (scale.x + scale.y + scale.z) / 3.0f;
    }
    Vec3 orientation[3];
    orientationOf(appearance[2], appearance[3], orientation);
    const auto& [right, down_of, ahead] = group.to_camera;
    Vec3 rows[2];
    if constexpr (kLens) {
      const auto inGroup = [&](const Vec3& d) {
        const auto along = [&](int i) {
          return d.x * right[i] + d.y * down_of[i] + d.z * ahead[i];
        };
        return Vec3{along(0), along(1), along(2)};
      };
      rows[0] = inGroup(imaged.of_x), rows[1] = inGroup(imaged.of_y);
    } else {
      rows[0] = {jx * right[0] + jxz * ahead[0], jx * right[1] + jxz * ahead[1],
                 jx * right[2] + jxz * ahead[2]};
      rows[1] = {jy * down_of[0] + jyz * ahead[0], jy * down_of[1] + jyz * ahead[1],
                 jy * down_of[2] + jyz * ahead[2]};
    }
    Vec3 m[2];
    for (int i = 0; i < 2; ++i) {
      m[i] = scale * Vec3{dot(rows[i], orientation[0]), dot(rows[i], orientation[1]),
                          dot(rows[i], orientation[2])};
    }
    Floats a, b, c, det;  // covariance of the response, and its determinant
    Conic<Floats> conic;
    if constexpr (kConic) {
      Rows<Floats> of = {{m[0].x, m[0].y, m[0].z}, {m[1].x, m[1].y, m[1].z}, {}};
      if (!view.orthographic) {
        const Floats over_z = 1.0f / p.z;
        const Floats* const scales = &scale.x;
        for (int k = 0; k < 3; ++k) {
          of.ahead[k] = over_z * scales[k] *
                        (ahead[0] * orientation[k].x + ahead[1] * orientation[k].y +
                         ahead[2] * orientation[k].z);
        }
      }
      conic = conicOf(of);
      a = conic.xx, b = conic.xy, c = conic.yy, det = conic.determinant;
    } else {
      const Vec3 area = {m[0].y * m[1].z - m[0].z * m[1].y, m[0].z * m[1].x - m[0].x * m[1].z,
                         m[0].x * m[1].y - m[0].y * m[1].x};
      const Floats a0 = dot(m[0], m[0]), c0 = dot(m[1], m[1]);
      const Floats det0 = dot(area, area);  // by Cauchy-Binet: no cancellation for needles
      b = dot(m[0], m[1]);
      a = a0 + kLowPass, c = c0 + kLowPass;
      det = det0 + kLowPass * (a0 + c0) + kLowPass * kLowPass;
      if (view.model == Model::kEwaAntialiased) opacity *= sqrt(det0 / det);
    }
    Vec2 slope;
    if constexpr (kPlanes) {  // what the depth is expected to be, given the place in the picture
      const auto along = [&](const Vec3& axis) {
        return ahead[0] * axis.x + ahead[1] * axis.y + ahead[2] * axis.z;
      };
      const Vec3 rise =
          scale * Vec3{along(orientation[0]), along(orientation[1]), along(orientation[2])};
      const Floats of_x = dot(m[0], rise), of_y = dot(m[1], rise), over = 1.0f / det;
      slope = {over * (c * of_x - b * of_y), over * (a * of_y - b * of_x)};
    }

    const Floats mid = 0.5f * (a + c), half = 0.5f * (a - c), radius = sqrt(half * half + b * b);
    Floats major = mid + radius, minor = det / major;
    if constexpr (kConic) {
      constexpr float kLeast = 1e-20f;  // of a splat without size [px^2]
      major = max(major, all(kLeast)), minor = max(minor, all(kLeast));
    }
    // Eigenvector of the larger eigenvalue, from the longer of two equivalent formulas.
    Vec2 axis = {a > c ? radius + half : b, a > c ? b : radius - half};
    const Floats norm = sqrt(axis.x * axis.x + axis.y * axis.y);
    const Floats over_norm = 1.0f / norm;
    axis = {norm > 0.0f ? axis.x * over_norm : all(1.0f),
            norm > 0.0f ? axis.y * over_norm : all(0.0f)};

    const Floats peak = log2(max(opacity, all(kCutoffAlpha)));
    const Floats sigmas =
        balls ? all(kBallSigmas)
              : min(sqrt((2.0f * kLog2) * max(peak - kCutoffEnd * kSquared, all(0.0f))),
                    all(kMaxSigmas));
    Ellipse outline = {x, y, a, b, c, det};
    Vec2 spot = {x, y};
    Box around;
    if constexpr (kConic) {
      if (view.model == Model::kDisc) {
        Vec2 beside;
        spotOf(conic, beside.x, beside.y);
        spot = {x + beside.x, y + beside.y};
      }
      outline = ellipseOf(view, conic, max(sigmas * sigmas, all(1e-6f)), x, y, spot, around);
    }
    Floats reach_y = sigmas * sqrt(outline.c);
    if constexpr (!kConic) {
      const Floats reach_x = sigmas * sqrt(outline.a);
      around = {x - reach_x, x + reach_x, y - reach_y, y + reach_y};
    }
    const Floats window_depth = windowDepthOf(view, p.z);
    const auto sampledIn = [&](Floats from, Floats to, float pixels) {
      if constexpr (kConic) from -= view.between, to += view.between;
      return pixelsIn(from, to, int(pixels));
    };
    PixelSpan columns = sampledIn(around.left, around.right, view.width);
    PixelSpan lines = sampledIn(around.top, around.bottom, view.height);
    Ints seen = (opacity >= kCutoffAlpha) & (major < 1e16f);
    if (!view.through_lens) seen &= window_depth >= 0.0f;
    if constexpr (kLens) seen &= imaged.met;
    seen &= (around.right > 0.0f) & (around.bottom > 0.0f) & (around.left < view.width) &
            (around.top < view.height);
    seen &= (columns.first < columns.last) & (lines.first < lines.last);
    seen &= counting() < float(lanes);
    Ints aside_lanes = {};
    Aside aside;
    if constexpr (kConic) {
      constexpr float kSteep = 0.05f;  // of z over distance
      if (view.through_lens) {
        aside_lanes = p.z <= kSteep * sqrt(dot(p, p));
        if (any(aside_lanes)) {
          Vec3 axes[3];
          for (int k = 0; k < 3; ++k) {
            const auto inCamera = [&](const float* row) {
              return row[0] * orientation[k].x + row[1] * orientation[k].y +
                     row[2] * orientation[k].z;
            };
            axes[k] = {inCamera(right), inCamera(down_of), inCamera(ahead)};
          }
          aside = asideOf(p, scale, axes, sigmas);
          const Ints counts = (opacity >= kCutoffAlpha) & aside.seen & (counting() < float(lanes));
          seen = aside_lanes ? counts : seen;
          columns.first = aside_lanes ? Ints{} : columns.first;
          columns.last = aside_lanes ? allInts(int(view.width)) : columns.last;
          lines.first = aside_lanes ? Ints{} : lines.first;
          lines.last = aside_lanes ? allInts(int(view.height)) : lines.last;
          const float around = view.width + view.height;
          const Floats wide = around * around / max(sigmas * sigmas, all(1e-6f));
          outline.x = aside_lanes ? all(0.5f * view.width) : outline.x;
          outline.y = aside_lanes ? all(0.5f * view.height) : outline.y;
          outline.a = aside_lanes ? wide : outline.a;
          outline.b = aside_lanes ? Floats{} : outline.b;
          outline.c = aside_lanes ? wide : outline.c;
          outline.determinant = aside_lanes ? wide * wide : outline.determinant;
          reach_y = aside_lanes ? all(around) : reach_y;
        }
      }
    }
    if (!any(seen)) continue;

    const Vec3 colour = colourOf(view, group, page, appearance, places, mean, p.z, scale,
                                 orientation, trained_opacity);
    const Floats per_sigma = all(kHalfLog2 / 4.0f);  // 4^2 is kSquared
    const Floats u = per_sigma / sqrt(major), v = per_sigma / sqrt(minor);
    static_assert(kSquared == 16);
    const Floats over_c = 1.0f / outline.c;
    const Floats half_width = sigmas * sqrt(outline.determinant * over_c);
    const Floats lean = outline.b * over_c, rightmost = sigmas * outline.b / sqrt(outline.a);
    const Floats kept_peak = balls ? Floats{} : peak * (1.0f / kSquared);

    // The tiles in the footprint's first rows, as across() in splat_tiles.glsl finds them.
    const PixelSpan box = tilesOf(columns), rows_of_tiles = tilesOf(lines);
    const Ints many = seen ? rows_of_tiles.last - rows_of_tiles.first : Ints{};
    Ints first[Footprint::kRows], last[Footprint::kRows];
    Floats down = toFloats(rows_of_tiles.first * kTile) + 0.5f - outline.y;
    const Floats over_reach = 1.0f / (reach_y * reach_y);
    for (int row = 0; row < Footprint::kRows; ++row, down += float(kTile)) {
      if (row > 0 && !any(many > row)) {
        first[row] = last[row] = Ints{};
        continue;
      }
      const float between = kConic ? view.between : 0.0f;
      const Floats from = clamp(down - between, -reach_y, reach_y);
      const Floats to = clamp(down + (float(kTile - 1) + between), -reach_y, reach_y);
      const Floats left = clamp(-rightmost, from, to), right = clamp(rightmost, from, to);
      const auto half = [&](Floats at) {
        return half_width * sqrt(max(1.0f - at * at * over_reach, Floats{}));
      };
      const PixelSpan span = tilesOf(sampledIn(outline.x + lean * left - half(left),
                                               outline.x + lean * right + half(right), view.width));
      first[row] = max(span.first, box.first);
      last[row] = min(span.last, box.last);
    }

    const Floats fields_of[] = {x,           y,          axis.x * u, axis.y * u,
                                -axis.y * v, axis.x * v, kept_peak,  colour.x,
                                colour.y,    colour.z,   p.z,        window_depth};
    constexpr int kFields = sizeof(fields_of) / sizeof(Floats);
    static_assert(kFields == offsetof(Record, left) / sizeof(float));
    for (int i = 0; i < lanes; ++i) {
      if (!seen[i]) continue;
      Record& record = records[n];
      for (int k = 0; k < kFields; ++k) (&record.x)[k] = fields_of[k][i];
      record.left = std::int16_t(columns.first[i]);
      record.top = std::int16_t(lines.first[i]);
      record.right = std::int16_t(columns.last[i]);
      record.bottom = std::int16_t(lines.last[i]);
      record.index = page.first_index + std::uint32_t(places[i]);
      record.share = ball_share < 0.0f ? ball_share : share[i];
      if constexpr (kConic) {
        const float per_square = kHalfLog2 * kHalfLog2 / kSquared;
        RayShape& shape = shapes[n];
        const bool has_spot = view.model == Model::kDisc;
        shape = {conic.tilt[0][i],
                 conic.tilt[1][i],
                 conic.nearness[i] / per_square,
                 has_spot ? spot.x[i] : __builtin_inff(),
                 spot.y[i],
                 0,
                 0,
                 1};
        if (aside_lanes[i]) {
          shape = {aside.along.x[i] / view.fx,
                   aside.along.y[i] / view.fy,
                   aside.nearness[i] / per_square,
                   __builtin_inff(),
                   0,
                   aside.u.z[i],
                   aside.v.z[i],
                   aside.along.z[i]};
          record.x = view.cx, record.y = view.cy;
          record.ux = aside.u.x[i] / view.fx, record.uy = aside.u.y[i] / view.fy;
          record.vx = aside.v.x[i] / view.fx, record.vy = aside.v.y[i] / view.fy;
          record.depth = aside.distance[i];
        }
      }
      if constexpr (kPlanes) shapes[n] = {slope.x[i], slope.y[i], 0, 0, 0, 0, 0, 0};
      Footprint& footprint = footprints[n];
      footprint.top = std::int16_t(rows_of_tiles.first[i]);
      footprint.bottom = std::int16_t(rows_of_tiles.last[i]);
      for (int row = 0; row < Footprint::kRows; ++row) {
        footprint.first[row] = std::int16_t(first[row][i]);
        footprint.last[row] = std::int16_t(last[row][i]);
      }
      footprint.left = std::int16_t(box.first[i]);
      footprint.right = std::int16_t(box.last[i]);
      if (many[i] > Footprint::kRows) {
        footprint.x = outline.x[i];
        footprint.y = outline.y[i];
        footprint.reach_y = reach_y[i];
        footprint.half_width = half_width[i];
        footprint.lean = lean[i];
        footprint.rightmost = rightmost[i];
        footprint.between = view.between;
      }
      kept[n] = std::uint16_t(first_of + std::size_t(i));
      ++n;
    }
  }
  return n;
}

std::size_t project(const ProjectView& view, const PageSlots& page, const std::uint16_t* places,
                    std::size_t count, Record* records, RayShape* shapes, Footprint* footprints,
                    std::uint16_t* kept) {
  if (view.model == Model::kRay || view.model == Model::kDisc) {
    return projectAs<true, false, false>(view, page, places, count, records, shapes, footprints,
                                         kept);
  }
  const auto as = view.lens.cubics
                      ? (view.planes ? projectAs<false, true, true> : projectAs<false, true, false>)
                  : view.planes ? projectAs<false, false, true>
                                : projectAs<false, false, false>;
  const std::size_t n = as(view, page, places, count, records, shapes, footprints, kept);
  for (std::size_t i = 0; shapes && !view.planes && i < n; ++i) {
    shapes[i] = {0, 0, 0, __builtin_inff(), 0, 0, 0, 1};
  }
  return n;
}

// 2^v for v of -8 / kSquared to 0, with a relative error of 8e-8 (minimax polynomial).
Floats exp2OfLittle(Floats v) {
  Floats p = all(0.00807774f);
  p = fma(p, v, all(0.05483838f));
  p = fma(p, v, all(0.24010635f));
  p = fma(p, v, all(0.69313946f));
  return fma(p, v, all(0.99999992f));
}

Floats falloffOf(Floats exponent) {
  Floats v = exp2OfLittle(exponent);
  for (int i = 0; i < kSquarings; ++i) v *= v;
  return v;
}

// Whether nothing behind can be seen in any pixel of a tile.
bool ended(const float* transmittance, const float* behind, float ends_at) {
  Floats largest = {};
  for (int i = 0; i < kTilePixels; i += kLanes) {
    const Floats t = load(transmittance + i);
    largest = max(largest, behind ? t * load(behind + i) : t);
  }
  float of_all = 0;
  for (int i = 0; i < kLanes; ++i) of_all = most(of_all, largest[i]);
  return of_all < ends_at;
}

constexpr std::size_t kAhead = 8;      // records are prefetched this many splats ahead
constexpr std::size_t kPatience = 32;  // splats between tests whether a tile has ended

// Calls blend(sample, exponents, covered, depths) for each vector of samples of a half of a tile.
template <typename Blend>
void atSamples(const ListedTile& tile, int half, const Record& e, const RayShape& shape,
               const Blend& blend) {
  const TileSamples& samples = tile.samples;
  const auto rowsBefore = [&](int line) {
    return int(samples.rows[half][least(most(line - tile.top, 0), kTile)]);
  };
  const int first = rowsBefore(e.top), last = rowsBefore(e.bottom);
  const int vectors = (last - first + kLanes - 1) / kLanes;
  const int begin = half * kHalfTile + least(first, kHalfTile - vectors * kLanes);
  // Of the tile's corner.
  const float dx = float(tile.left) - e.x, dy = float(tile.top) - e.y;
  const Floats u_there = all(e.ux * dx + e.uy * dy + shape.u);
  const Floats v_there = all(e.vx * dx + e.vy * dy + shape.v);
  const Floats line_there = all(shape.tilt_x * dx + shape.tilt_y * dy + shape.along);
  const Floats peak = all(e.peak), depth = all(e.depth);
  const Floats end = all(e.share < 0.0f ? kBallEnd : kCutoffEnd);
  const auto along = [&](const auto& withSpot) {
    for (int i = begin; i < begin + vectors * kLanes; i += kLanes) {
      const Floats x = load(samples.x + i), y = load(samples.y + i);
      const Floats u = fma(x, all(e.ux), fma(y, all(e.uy), u_there));
      const Floats v = fma(x, all(e.vx), fma(y, all(e.vy), v_there));
      // Of what is behind the camera, the largest response is at the camera, 1 / nearness away.
      const Floats line = fma(x, all(shape.tilt_x), fma(y, all(shape.tilt_y), line_there));
      const Floats ahead = max(line, Floats{}), flat = max(fma(v, v, u * u), all(1e-20f));
      const Floats over = 1.0f / fma(ahead, ahead, shape.nearness * flat);
      Floats exponent = fma(-flat, over, peak), seen = max(depth * ahead * over, Floats{});
      withSpot(x, y, exponent, seen);
      blend(i, exponent, exponent >= end, seen);
    }
  };
  if (shape.spot_x == __builtin_inff()) {
    along([](const Floats&, const Floats&, Floats&, Floats&) {});
    return;
  }
  const Floats spot = all(kSpot * kHalfLog2 * kHalfLog2 / kSquared);
  const Floats spot_x = all(shape.spot_x - float(tile.left));
  const Floats spot_y = all(shape.spot_y - float(tile.top));
  along([&](const Floats& x, const Floats& y, Floats& exponent, Floats& seen) {
    const Floats beside = x - spot_x, below = y - spot_y;
    const Floats of_spot = fma(-spot * below, below, peak - spot * beside * beside);
    seen = exponent >= of_spot ? seen : depth;
    exponent = max(exponent, of_spot);
  });
}

// Calls blendOf(record)(pixel, exponents, covered, depths) for each splat of a tile, nearest first,
// and for each vector of pixels in the splat's box, until nothing behind can be seen. Returns
// whether that is so at the end.
enum class Shape { kFlat, kPlane, kConic };
template <Shape kShape, typename BlendOf>
bool walk(const ListedTile& tile, const float* transmittance, const float* behind, float ends_at,
          const BlendOf& blendOf) {
  constexpr bool kConic = kShape == Shape::kConic;
  const Floats columns = counting();
  const Listed* const listed = tile.listed;
  const Record* const records = tile.records;
  const std::size_t count = tile.count;
  const int left = tile.left, top = tile.top;
  for (std::size_t k = 0; k < count; ++k) {
    if (k % kPatience == 0 && ended(transmittance, behind, ends_at)) return true;
    if (k + kAhead < count) {
      __builtin_prefetch(records + listed[k + kAhead].record);
      if (kShape != Shape::kFlat) __builtin_prefetch(tile.shapes + listed[k + kAhead].record);
    }
    const Record& e = records[listed[k].record];
    const auto blend = blendOf(e);
    if (kConic && tile.samples.x) {
      const RayShape& shape = tile.shapes[listed[k].record];
      if (e.left < left + kTile / 2) atSamples(tile, 0, e, shape, blend);
      if (e.right > left + kTile / 2) atSamples(tile, 1, e, shape, blend);
      continue;
    }
    const int first = most(e.top - top, 0), last = least(e.bottom - top, kTile);
    const int begin = kLanes == kTile ? 0 : most(e.left - left, 0) / kLanes * kLanes;
    const int end_column = kLanes == kTile ? kTile : least(e.right - left, kTile);
    const float dx = float(left) + 0.5f - e.x, dy = float(top + first) + 0.5f - e.y;
    const Floats along_u = fma(columns, all(e.ux), all(e.ux * dx + e.uy * dy));
    const Floats along_v = fma(columns, all(e.vx), all(e.vx * dx + e.vy * dy));
    const Floats down_u = all(e.uy), down_v = all(e.vy), peak = all(e.peak);
    const Floats depth = all(e.depth);
    const Floats end = all(e.share < 0.0f ? kBallEnd : kCutoffEnd);
    for (int column = begin; column < end_column; column += kLanes) {
      Floats u = along_u + float(column) * e.ux, v = along_v + float(column) * e.vx;
      if constexpr (kConic) {
        const RayShape& shape = tile.shapes[listed[k].record];
        const Floats x = columns + (float(column) + dx);
        Floats along = fma(x, all(shape.tilt_x), all(1.0f + shape.tilt_y * dy));
        const auto rows = [&](const auto& withSpot) {
          for (int row = first; row < last; ++row) {
            const Floats flat = fma(v, v, u * u);
            const Floats over = 1.0f / fma(along, along, shape.nearness * flat);
            Floats exponent = fma(-flat, over, peak), seen = max(depth * along * over, Floats{});
            withSpot(exponent, seen);
            blend(kTile * row + column, exponent, exponent >= end, seen);
            u += down_u;
            v += down_v;
            along += shape.tilt_y;
          }
        };
        if (shape.spot_x == __builtin_inff()) {
          rows([](Floats&, Floats&) {});
        } else {
          const Floats beside = x + (e.x - shape.spot_x);
          const Floats spot = all(kSpot * kHalfLog2 * kHalfLog2 / kSquared);
          const Floats level = peak - spot * beside * beside;
          Floats below = all(dy + e.y - shape.spot_y);
          rows([&](Floats& exponent, Floats& seen) {
            const Floats of_spot = fma(-spot * below, below, level);
            seen = exponent >= of_spot ? seen : depth;
            exponent = max(exponent, of_spot);
            below += 1.0f;
          });
        }
      } else {
        Floats plane = depth;
        float deeper = 0;
        if constexpr (kShape == Shape::kPlane) {
          const RayShape& shape = tile.shapes[listed[k].record];
          deeper = shape.tilt_y;
          plane += shape.tilt_x * (columns + (float(column) + dx)) + deeper * dy;
        }
        for (int row = first; row < last; ++row) {
          const Floats exponent = fma(-v, v, fma(-u, u, peak));
          const Floats seen = kShape == Shape::kPlane ? max(plane, Floats{}) : depth;
          blend(kTile * row + column, exponent, exponent >= end, seen);
          u += down_u;
          v += down_v;
          if constexpr (kShape == Shape::kPlane) plane += deeper;
        }
      }
    }
  }
  return ended(transmittance, behind, ends_at);
}

// Blends a splat into a vector of pixels.
template <PictureDepth kDepth>
ROSPLAT_INLINED void blendInto(TilePixels& into, int pixel, Floats falloff, Ints where,
                               const Floats (&colour)[3], Floats depth, float share) {
  Floats alpha = min(falloff, all(kMaxAlpha));
  if (share < 1.0f) {
    alpha = share < 0.0f ? all(1.0f) : 1.0f - exp2(share * log2(1.0f - alpha));
  }
  alpha = where ? alpha : Floats{};
  const Floats transmittance = load(into.transmittance + pixel);
  Floats weight = transmittance * alpha;
  const Floats behind = transmittance - weight;
  store(into.transmittance + pixel, behind);
  if (kDepth == PictureDepth::kMean) {
    store(into.depth + pixel, fma(weight, depth, load(into.depth + pixel)));
  }
  if (kDepth == PictureDepth::kMedian) {
    const Floats so_far = load(into.depth + pixel);
    store(into.depth + pixel, (transmittance > 0.5f) & (behind <= 0.5f) ? depth : so_far);
  }
  if (share == kGaussianBallShare) weight = where ? weight * falloff : Floats{};
  for (int i = 0; i < 3; ++i) {
    float* const channel = into.colour[i] + pixel;
    store(channel, fma(weight, colour[i], load(channel)));
  }
}

template <Shape kShape, PictureDepth kDepth, bool kOpaque, bool kDivided>
bool blendAs(const BlendTile& tile) {
  TilePixels& pixels = *tile.pixels;
  return walk<kShape>(
      tile, pixels.transmittance, kDivided ? tile.behind->transmittance : nullptr, tile.ends_at,
      [&](const Record& e) {
        const Floats colour[3] = {all(e.colour[0]), all(e.colour[1]), all(e.colour[2])};
        const Floats window_depth = all(e.window_depth);
        const float share = e.share;
        return [=, &pixels, &tile](int pixel, Floats exponent, Ints covered, Floats depth) {
          const Floats falloff = falloffOf(exponent);
          if (kOpaque) covered &= window_depth <= load(tile.opaque + pixel);
          if (!kDivided) {
            blendInto<kDepth>(pixels, pixel, falloff, covered, colour, depth, share);
            return;
          }
          const Ints before = window_depth <= load(tile.divided + pixel);
          blendInto<kDepth>(pixels, pixel, falloff, covered & before, colour, depth, share);
          blendInto<PictureDepth::kMean>(*tile.behind, pixel, falloff, covered & ~before, colour,
                                         1.0f - window_depth, share);
        };
      });
}

template <Shape kShape, PictureDepth kDepth>
bool blendWith(const BlendTile& tile) {
  if (tile.divided) {
    return tile.opaque ? blendAs<kShape, kDepth, true, true>(tile)
                       : blendAs<kShape, kDepth, false, true>(tile);
  }
  return tile.opaque ? blendAs<kShape, kDepth, true, false>(tile)
                     : blendAs<kShape, kDepth, false, false>(tile);
}

template <Shape kShape>
bool blendTo(const BlendTile& tile, PictureDepth depth) {
  if (depth == PictureDepth::kMean) return blendWith<kShape, PictureDepth::kMean>(tile);
  if (depth == PictureDepth::kMedian) return blendWith<kShape, PictureDepth::kMedian>(tile);
  return blendWith<kShape, PictureDepth::kNone>(tile);
}

bool blend(const BlendTile& tile, PictureDepth depth) {
  if (tile.planes) return blendTo<Shape::kPlane>(tile, depth);
  return tile.shapes ? blendTo<Shape::kConic>(tile, depth) : blendTo<Shape::kFlat>(tile, depth);
}

template <Shape kShape>
bool pickAs(const PickTile& tile) {
  return walk<kShape>(tile, tile.transmittance, nullptr, kLeastPicked, [&](const Record& e) {
    const bool ball = e.share < 0.0f;
    return [=, &e, &tile](int pixel, Floats exponent, Ints covered, Floats) {
      if (tile.opaque) covered &= all(e.window_depth) <= load(tile.opaque + pixel);
      const Floats alpha =
          covered ? (ball ? all(1.0f) : min(falloffOf(exponent), all(kMaxAlpha))) : Floats{};
      const Floats transmittance = load(tile.transmittance + pixel);
      const Floats weight = transmittance * alpha;
      const Floats so_far = load(tile.most + pixel);
      const Ints more = weight > so_far;
      store(tile.most + pixel, more ? weight : so_far);
      const Ints index = load<Ints>(tile.index + pixel);
      store(tile.index + pixel, more ? allInts(std::int32_t(e.index)) : index);
      store(tile.transmittance + pixel, transmittance - weight);
    };
  });
}

bool pick(const PickTile& tile) {
  return tile.shapes ? pickAs<Shape::kConic>(tile) : pickAs<Shape::kFlat>(tile);
}

// The sum of all lanes. Adding lane after lane would take longer than blending a splat's pixels.
float sumOf(Floats v) {
  typedef float Four __attribute__((vector_size(16)));
  Four parts[kLanes / 4];
  store(parts, v);
  Four sum = parts[0];
  for (int i = 1; i < kLanes / 4; ++i) sum += parts[i];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

template <Shape kShape>
bool contributeAs(const ContributeTile& tile) {
  TilePixels& pixels = *tile.pixels;
  Contribution* next = tile.splats;
  Floats weights = {}, energies = {}, errors = {}, residuals = {};  // of the current splat
  const auto finish = [&] {
    if (next == tile.splats) return;
    next[-1] = {sumOf(weights), sumOf(energies), sumOf(errors), sumOf(residuals)};
    weights = energies = errors = residuals = Floats{};
  };
  const bool has_ended =
      walk<kShape>(tile, pixels.transmittance, nullptr, tile.ends_at, [&](const Record& e) {
        finish();
        ++next;
        const Floats colour[3] = {all(e.colour[0]), all(e.colour[1]), all(e.colour[2])};
        return [=, &pixels, &tile, &weights, &energies, &errors, &residuals, &e](
                   int pixel, Floats exponent, Ints covered, Floats) {
          if (tile.opaque) covered &= all(e.window_depth) <= load(tile.opaque + pixel);
          const Floats alpha = covered ? min(falloffOf(exponent), all(kMaxAlpha)) : Floats{};
          const Floats transmittance = load(pixels.transmittance + pixel);
          const Floats weight = transmittance * alpha;
          store(pixels.transmittance + pixel, transmittance - weight);
          weights += weight;
          energies = fma(weight, weight, energies);
          if (tile.residual) {
            residuals = fma(weight, load(tile.residual + pixel), residuals);
          }
          // Without the splat, the colour behind would be 1 / (1 - alpha) times as strong.
          const Floats uncovers = alpha / (1.0f - alpha);
          for (int i = 0; i < 3; ++i) {
            float* const channel = pixels.colour[i] + pixel;
            const Floats behind = fma(-weight, colour[i], load(channel));
            store(channel, behind);
            const Floats change = fma(weight, colour[i], -uncovers * behind);
            errors = fma(change, change, errors);
          }
        };
      });
  finish();
  for (; next < tile.splats + tile.count; ++next) *next = {};
  return has_ended;
}

bool contribute(const ContributeTile& tile) {
  return tile.shapes ? contributeAs<Shape::kConic>(tile) : contributeAs<Shape::kFlat>(tile);
}

// Plain loops over a row of kTile pixels, which compilers vectorise.
DepthSums findDepths(const DepthTile& tile) {
  const auto width = std::size_t(tile.width);
  float depths[kTile] = {}, weights[kTile] = {};
  for (int y = 0; y < tile.height; ++y) {
    const std::size_t first = std::size_t(y) * tile.stride;
    const auto alphasOf = [&](const float* rgba, float* alphas) {
      if (width == kTile) {
        for (std::size_t x = 0; x < kTile; ++x) alphas[x] = rgba[4 * (first + x) + 3];
      } else {
        for (std::size_t x = 0; x < width; ++x) alphas[x] = rgba[4 * (first + x) + 3];
      }
    };
    float alphas[kTile] = {}, alphas_behind[kTile] = {}, means[kTile] = {};
    alphasOf(tile.colour, alphas);
    if (tile.behind) alphasOf(tile.behind, alphas_behind);
    __builtin_memcpy(means, tile.depth + first, width * sizeof(float));
    for (std::size_t x = 0; x < kTile; ++x) {
      const bool there = alphas[x] > 0;
      means[x] = there ? means[x] / alphas[x] : __builtin_nanf("");
      const float value = tile.orthographic ? means[x] : 1 / means[x];
      const float weight = alphas[x] + alphas_behind[x];
      depths[x] += there ? weight * value : 0;
      weights[x] += there ? weight : 0;
    }
    __builtin_memcpy(tile.depth + first, means, width * sizeof(float));
  }
  DepthSums sums{};
  for (std::size_t x = 0; x < kTile; ++x) {
    sums.depth += depths[x];
    sums.alpha += weights[x];
  }
  return sums;
}

void toBytes(const float* from, std::size_t count, std::uint8_t* bytes) {
  const auto each = [](Floats v) {
    return __builtin_convertvector(toInts(clamp(v, all(0.0f), all(1.0f)) * 255.0f + 0.5f), Bytes);
  };
  std::size_t i = 0;
  for (; i + kLanes <= count; i += kLanes) store(bytes + i, each(load(from + i)));
  for (; i < count; ++i) bytes[i] = each(all(from[i]))[0];
}

}  // namespace

#define ROSPLAT_QUOTE(name) #name
#define ROSPLAT_NAME(name) ROSPLAT_QUOTE(name)
const Kernels kKernels = {ROSPLAT_NAME(ROSPLAT_TARGET),
                          cull,
                          hide,
                          project,
                          blend,
                          pick,
                          contribute,
                          findDepths,
                          toBytes};

}  // namespace rosplat::cpu::ROSPLAT_TARGET
