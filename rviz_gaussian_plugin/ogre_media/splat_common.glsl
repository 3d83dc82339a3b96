// What all passes share. The class Shaders puts #version, its defines for the driver (as PART_BYTES) and
// for what splats are drawn as (Shapes), and the engine's constants (rosplat_core/slots/constants.hpp) before this.

// Opacity of a Gaussian that falls below kCutoffAlpha at kBallEdge of its peak, or a little beyond.
const float kBallOpacity = 0.0179;
const uint kNone = 0xffffffffu;

#ifdef COMPUTE
// Work groups have 256 invocations; dispatches may be folded into two dimensions.
uint workGroup() { return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x; }
uint invocation() { return workGroup() * 256u + gl_LocalInvocationIndex; }
uint workGroups() { return gl_NumWorkGroups.x * gl_NumWorkGroups.y; }
#endif

const uint kBlock = 4096u;  // keys that a work group sorts at once

// A count that the CPU does not wait for. So it dispatches about as many work groups as are needed, and these
// share what there is.
struct Tally {
  uint count;   // no more than there is room for
  uint wanted;  // what the count would be with room for all
};

Tally tallied(uint wanted, uint room) { return Tally(min(wanted, room), wanted); }

// Of the splats that a view sees.
struct SeenTally {
  uint count, unused;  // as a Tally, but there is room for all
  uint nearest, farthest;                    // keys of the depths of all
  uint nearest_coloured, farthest_coloured;  // keys of the depths of splats of kByDepth
};

// What a splat is blended as.
const uint kGaussian = 0u;
const uint kFlat = 1u, kShaded = 2u;  // solid balls; kShaded is darker towards its rim
const uint kByDepth = 3u;             // kGaussian, and coloured only once the depths of all are known

// A splat in the picture.
struct Ellipse {
  vec2 centre;    // [px]
  float depth;    // along the view's axis [m]
  vec2 major;     // half axis of one sigma [px]
  float minor;    // length of the other one, a quarter turn on [px]
  vec3 colour;    // not negative
  float opacity;  // 0: not drawn; a node's is up to kMostNodeOpacity, a ball's is kBallOpacity
  uint kind;
#ifdef RAYS
  vec2 tilt;       // as in splat_conic.glsl; 0 of ellipses in the picture [1/px]
  float nearness;  // the same
  bool has_spot;   // is a disc
#endif
};

#ifdef RAYS
struct PackedEllipse { uvec4 a, b, c; };
#else
struct PackedEllipse { uvec4 a, b; };
#endif

// A negative minor axis says that the opacity is divided by kMostNodeOpacity. The signs of red and green
// are the kind's bits.
PackedEllipse packEllipse(Ellipse e) {
  if (e.opacity > 1.0) {
    e.opacity /= kMostNodeOpacity;
    e.minor = -e.minor;
  }
  uint kind = (e.kind & 1u) << 15 | (e.kind >> 1) << 31;
  return PackedEllipse(
      uvec4(floatBitsToUint(vec3(e.centre, e.depth)), packHalf2x16(abs(e.colour.rg)) | kind),
      uvec4(floatBitsToUint(vec3(e.major, e.minor)),
            packHalf2x16(vec2(e.colour.b, 0.0)) | packUnorm2x16(vec2(0.0, e.opacity)))
#ifdef RAYS
      , uvec4(floatBitsToUint(vec3(e.tilt, e.nearness)), uint(e.has_spot))
#endif
  );
}

Ellipse unpackEllipse(PackedEllipse p) {
  Ellipse e;
  e.centre = uintBitsToFloat(p.a.xy);
  e.depth = uintBitsToFloat(p.a.z);
  e.major = uintBitsToFloat(p.b.xy);
  e.minor = abs(uintBitsToFloat(p.b.z));
  e.colour = vec3(unpackHalf2x16(p.a.w & 0x7fff7fffu), unpackHalf2x16(p.b.w).x);
  e.kind = (p.a.w >> 15 & 1u) | p.a.w >> 31 << 1;
  e.opacity = unpackUnorm2x16(p.b.w).y * (uintBitsToFloat(p.b.z) < 0.0 ? kMostNodeOpacity : 1.0);
#ifdef RAYS
  e.tilt = uintBitsToFloat(p.c.xy);
  e.nearness = uintBitsToFloat(p.c.z);
  e.has_spot = p.c.w != 0u;
#endif
  return e;
}

vec2 minorDirection(Ellipse e) { return normalize(vec2(-e.major.y, e.major.x)); }

vec2 minorAxis(Ellipse e) { return e.minor * minorDirection(e); }

float cutoffSigmas(float opacity) { return min(kMaxSigmas, sqrt(2.0 * log(255.0 * opacity))); }

// A Gaussian's falloff is exp(-x^2 / 2), x in lengths of its axes.

// Directions of the axes over their lengths, times kHalfLog2. [1/px]
vec4 falloffAxes(Ellipse e) {
  return vec4(kHalfLog2 * e.major / dot(e.major, e.major), kHalfLog2 * minorDirection(e) / e.minor);
}

// The square of the distance from the centre that the falloff is exp2(-) of, at an offset [px].
float squareAt(vec4 axes, vec2 offset) {
  vec2 sigmas = vec2(dot(offset, axes.xy), dot(offset, axes.zw));
  return dot(sigmas, sigmas);
}

// What pixels need to know of the kind: the opacity or, for a ball, one of these numbers below 0.
const float kFlatPeak = -1.0, kShadedPeak = -2.0;

float peakOf(Ellipse e) {
  return e.kind == kFlat ? kFlatPeak : e.kind == kShaded ? kShadedPeak : e.opacity;
}

// How opaque a splat is at a falloff; less than kCutoffAlpha can't be seen.
float alphaAt(float peak, float falloff) {
  return peak < 0.0 ? float(falloff >= kBallEdge) : min(kMaxAlpha, peak * falloff);
}

// The alpha of a share of a splat, given that of the whole (see cut.hpp). Balls stay solid.
float sharedAlpha(float alpha, float share) {
  return share >= 1.0 || alpha > kMaxAlpha ? alpha : 1.0 - exp2(share * log2(1.0 - alpha));
}

// The key that a depth is sorted by: grows with the depth, also where that is negative.
uint depthKey(float depth) {
  uint bits = floatBitsToUint(depth + 0.0);  // the sum makes one depth of -0 and 0
  return bits ^ (uint(int(bits) >> 31) | 0x80000000u);
}

float keyDepth(uint key) {
  return uintBitsToFloat((key & 0x80000000u) != 0u ? key ^ 0x80000000u : ~key);
}

// Google's Turbo, blue to red over 0 to 1 (polynomial of Mikhailov 2019).
vec3 turbo(float t) {
  t = clamp(t, 0.0, 1.0);
  vec4 v4 = vec4(1.0, t, t * t, t * t * t);
  vec2 v2 = v4.zw * v4.z;
  return clamp(vec3(dot(v4, vec4(0.13572138, 4.61539260, -42.66032258, 132.13108234)) +
                        dot(v2, vec2(-152.94239396, 59.28637943)),
                    dot(v4, vec4(0.09140261, 2.19418839, 4.84296658, -14.18503333)) +
                        dot(v2, vec2(4.27729857, 2.82956604)),
                    dot(v4, vec4(0.10667330, 12.64194608, -60.58204836, 110.36276771)) +
                        dot(v2, vec2(-89.90310912, 27.34824973))),
               0.0, 1.0);
}

// Red for near, blue for far.
vec3 depthColour(float depth, vec2 range) {
  return turbo(1.0 - (depth - range.x) / max(range.y - range.x, 1e-6));
}

// The texel of a pixel, counted from the picture's top, in a target of some rows.
ivec2 texelOf(ivec2 pixel, int rows, bool top_first) {
  return ivec2(pixel.x, top_first ? pixel.y : rows - 1 - pixel.y);
}
