#pragma once

// What the engine, its kernels and the shaders have in common, once: plain types alone, for the
// kernels. The plugin's gl/constants.cpp hands them to GLSL.

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

// What values of a channel are drawn as.
enum ChannelKind { kNoColours, kGradient, kCategories };

constexpr std::uint32_t kPageSlots = 1024;  // neighbours that are kept together

constexpr float kLowPass = 0.3f;  // [px^2], part of the trained model
constexpr float kCutoffAlpha = 1.0f / 255.0f;
constexpr float kLog2Cutoff = -7.99435344f;  // log2 of that
// What a pixel still lets through where it ends. On the processor as in gsplat: 106 dB and more
// against blending all. A card's tiles go on, nearer to its quads, which blend all.
constexpr float kTransparent = 1e-4f;
constexpr float kTransparentInTiles = 1e-5f;
// A tangent is clamped so far beyond the picture, in its sizes: 0.3 tan(fov / 2), as trained.
constexpr double kTangentSlack = 0.15;
constexpr float kMaxSigmas = 4.08f;       // where the most opaque node falls below the cutoff
constexpr float kMaxAlpha = 0.99f;        // as in Kerbl et al. 2023; nothing is ever fully opaque
constexpr float kBallEdge = 0.22f;        // of the peak: a ball ends at 1.74 sigma
constexpr float kHalfLog2 = 0.84932180f;  // sqrt(log2(e) / 2): exp(-x^2 / 2) = exp2(-(k x)^2)
// The opacity of nodes goes farther than that of splats, and is clamped pixel by pixel.
constexpr float kMostNodeOpacity = 16;
constexpr float kLeastPicked = 0.05f;  // contribution to a pixel; less nobody sees

constexpr int kTile = 16;  // of a picture, in width and height [px]

constexpr int kLevels = 28;         // of detail
constexpr int kFinestOctave = -13;  // the smallest cells are 2^-13 m wide
// Wider than any camera is far away: of what has no cell. [m]
constexpr float kBoundless = 0x1p100f;

}  // namespace rosplat
