// Which splat a pixel shows: the one that contributes most to its colour, alpha times the
// transmittance of what lies before it. A work group walks what is drawn front to back for a tile of
// pixels, a batch of splats at a time.

layout(local_size_x = 16, local_size_y = 16) in;
layout(std430, binding = 4) readonly buffer Drawn { uint drawn[]; };     // nearest first
layout(std430, binding = 7) writeonly buffer Picked { uint picked[]; };  // slot, or kNone
layout(std430, binding = 8) readonly buffer Length { Tally drawn_tally; };
layout(binding = 0) uniform sampler2D scene_depth;

uniform uint words;      // of the visible slots' bits
uniform ivec2 picture;   // [px]
uniform bool top_first;  // the target's first row is the picture's top
uniform int mode;

const float kLeastContribution = 0.05;  // less than this nobody sees
const uint kBatch = 256u, kWords = kBatch / 32u;

// The splats of a batch that reach the tile, nearest first.
shared uint reaching[kWords];  // a bit for each of the batch
shared uint searching;         // pixels that a farther splat may still win
shared uint indices[kBatch];
shared vec4 places[kBatch];  // centre [px], window depth, opacity
shared vec4 axes[kBatch];    // directions of the axes over their lengths [1/px]

float alphaAt(uint k, vec2 pixel) {
  vec2 offset = pixel - places[k].xy;
  vec2 sigmas = vec2(dot(offset, axes[k].xy), dot(offset, axes[k].zw));
  float falloff = exp(-0.5 * dot(sigmas, sigmas));
  if (mode == kFlatBall || mode == kGaussianBall) return falloff < kBallEdge ? 0.0 : 1.0;
  float alpha = min(kMaxAlpha, places[k].w * falloff);
  return alpha < kCutoffAlpha ? 0.0 : alpha;
}

void main() {
  uint lane = gl_LocalInvocationIndex;
  ivec2 tile = ivec2(int(workGroup()) % tiles.x, int(workGroup()) / tiles.x);
  if (tile.y >= tiles.y) return;
  ivec2 pixel = tile * kTile + ivec2(gl_LocalInvocationID.xy);
  bool inside = all(lessThan(pixel, picture));
  ivec2 texel = ivec2(pixel.x, top_first ? pixel.y : picture.y - 1 - pixel.y);
  float hidden_from = inside ? texelFetch(scene_depth, texel, 0).r : 0.0;
  float transmittance = inside ? 1.0 : 0.0, most = kLeastContribution;
  uint winner = kNone, count = drawn_tally.count;

  for (uint taken = 0u; taken < count; taken += kBatch) {
    if (lane < kWords) reaching[lane] = 0u;
    if (lane == 0u) searching = 0u;
    barrier();
    if (transmittance > most) atomicAdd(searching, 1u);
    Ellipse e;
    e.opacity = 0.0;
    uint index = taken + lane < count ? drawn[taken + lane] : kNone;
    if (index != kNone) e = ellipse(index);
    bool reaches = false;
    if (e.opacity > 0.0) {
      Outline outline = outlineOf(e);
      ivec2 rows = tileRows(outline), columns = tileColumns(outline, tile.y);
      reaches = all(greaterThanEqual(tile, ivec2(columns.x, rows.x))) &&
                all(lessThan(tile, ivec2(columns.y, rows.y)));
    }
    if (reaches) atomicOr(reaching[lane / 32u], 1u << (lane % 32u));
    barrier();
    if (searching == 0u) break;
    uint kept = 0u, before_me = 0u;
    for (uint word = 0u; word < kWords; ++word) {
      if (word == lane / 32u) {
        before_me = kept + uint(bitCount(reaching[word] & ((1u << (lane % 32u)) - 1u)));
      }
      kept += uint(bitCount(reaching[word]));
    }
    if (reaches) {
      indices[before_me] = index;
      places[before_me] = vec4(e.centre, windowDepth(e.depth), e.opacity);
      axes[before_me] = vec4(e.major / dot(e.major, e.major), minorAxis(e) / (e.minor * e.minor));
    }
    barrier();
    for (uint k = 0u; k < kept && transmittance > most; ++k) {
      if (places[k].z > hidden_from || places[k].z < 0.0) continue;
      float alpha = alphaAt(k, vec2(pixel) + 0.5);
      if (transmittance * alpha > most) {
        most = transmittance * alpha;
        winner = indices[k];
      }
      transmittance *= 1.0 - alpha;
    }
  }
  if (inside && winner != kNone) picked[texel.y * picture.x + texel.x] = visibleSlot(winner, words);
}
