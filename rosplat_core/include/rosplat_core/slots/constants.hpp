#pragma once

// The constants that the engine, its kernels and the shaders share. Plain types only, for the
// kernels. The plugin's gl/constants.cpp hands these constants to GLSL.

#include <cstdint>

namespace rosplat {

// What a splat is drawn as.
enum class DrawMode {
  kColor,         // as trained
  kDepth,         // colour-mapped distance along the view's axis
  kBillboard,     // isotropic, of the mean of its scales
  kFlatBall,      // a solid ellipsoid in one colour
  kGaussianBall,  // a solid ellipsoid, darker towards its rim
  kNormals,       // the shortest axis, towards the camera: 0.5 + 0.5 n in the map's frame
  kOpacity,       // colour-mapped peak opacity
  kAge,           // colour-mapped time since a slot last changed, new is red
  kChannel,       // colour-mapped values of a channel; grey where there are none
};

// How a map's splats become pixels, which is how it was trained: see GaussianArray.msg.
enum class Model : std::uint8_t { kEwa, kEwaAntialiased, kRay, kDisc };

// How values of a channel are coloured.
enum ChannelKind { kNoColours, kGradient, kCategories };

constexpr std::uint32_t kPageSlots = 1024;  // kept together; as GaussianArray.SLOTS_PER_BLOCK

constexpr double kShC0 = 0.28209479177387814;  // band 0 of spherical harmonics

constexpr float kLowPass = 0.3f;  // [px^2], part of the trained model
constexpr float kCutoffAlpha = 1.0f / 255.0f;
constexpr float kLog2Cutoff = -7.99435344f;  // log2(kCutoffAlpha)
// The transmittance at which a pixel is complete. On the processor as in gsplat: 106 dB and more
// against blending all splats. A card goes on, which costs it next to nothing.
constexpr float kTransparent = 1e-4f;
constexpr float kTransparentInTiles = 1e-5f;
// How far beyond the picture tangents are clamped [picture sizes]: 0.3 tan(fov / 2), as trained.
constexpr double kTangentSlack = 0.15;
constexpr float kMaxSigmas = 4.08f;       // where the most opaque node falls below the cutoff
constexpr float kMaxAlpha = 0.999f;       // as in gsplat; nothing is ever fully opaque
constexpr float kBallEdge = 0.22f;        // share of the peak at a ball's edge: 1.74 sigma
constexpr float kHalfLog2 = 0.84932180f;  // sqrt(log2(e) / 2): exp(-x^2 / 2) = exp2(-(k x)^2)
// The largest opacity of a node. It may exceed 1, unlike a splat's; alpha is clamped in each pixel.
constexpr float kMostNodeOpacity = 16;
constexpr float kLeastPicked = 0.05f;  // least contribution to a pixel that can be picked

constexpr float kSpot = 2;            // 1 / the variance of a disc's spot [1/px^2]
constexpr float kLeastAhead = 1e-3f;  // the least w of a closed outline (conic.hpp)

constexpr int kTile = 16;  // width and height of a picture's tiles [px]

constexpr int kLevels = 28;         // levels of detail
constexpr int kFinestOctave = -13;  // the smallest cells are 2^-13 m wide
// The width of the cell of what has no cell: larger than the distance to any camera. [m]
constexpr float kBoundless = 0x1p100f;

}  // namespace rosplat
