// Finds the splat that a pixel shows: the one that contributes most to its colour, alpha times the
// transmittance of the splats before it. A work group walks a tile's splats front to back, a batch at a time.

layout(local_size_x = 16, local_size_y = 16) in;
layout(std430) readonly buffer Listed { uint listed[]; };
layout(std430) readonly buffer Lists { TileList lists[]; };
layout(std430) writeonly buffer Picked { uint picked[]; };  // as page_table.hpp numbers slots, or kNone
layout(binding = 0) uniform sampler2D scene_depth;

const uint kBatch = 256u;

shared uint searching;  // pixels that a farther splat may still win
shared uint indices[kBatch];
shared vec4 places[kBatch];  // centre [px], window depth, peakOf()
shared vec4 axes[kBatch];    // falloffAxes()
#ifdef RAYS
shared vec4 tilts[kBatch];  // tiltOf()
#endif
#ifdef DISCS
shared vec2 spots[kBatch];  // of discs; far away where there is none [px]
#endif

float pixelAlpha(uint k, vec2 pixel) {
  float square = squareAt(axes[k], pixel - places[k].xy);
#ifdef RAYS
  square = squareOfRay(tilts[k], alongRay(tilts[k], pixel), square);
#endif
#ifdef DISCS
  square = min(square, squareInSpot(pixel - spots[k]));
#endif
  return alphaAt(places[k].w, exp2(-square));
}

void collect(uint k, uint index) {
  Ellipse e = ellipse(index);
  indices[k] = index;
  places[k] = vec4(e.centre, windowDepth(e.depth), peakOf(e));
  axes[k] = falloffAxes(e);
#ifdef RAYS
  tilts[k] = tiltOf(e, vec2(0.0));
#endif
#ifdef DISCS
  spots[k] = e.has_spot ? spotOf(e) : vec2(kEverywhere);
#endif
}

void main() {
  uint lane = gl_LocalInvocationIndex;
  ivec2 tile = groupTile();
  if (tile.y >= view.tiles.y) return;
  ivec2 pixel = tile * kTile + ivec2(gl_LocalInvocationID.xy);
  bool inside = all(lessThan(pixel, view.picture));
  ivec2 texel = texelOf(pixel, view.picture.y, view.top_first);
  float hidden_from = inside ? texelFetch(scene_depth, texel, 0).r : 0.0;
  float transmittance = inside ? 1.0 : 0.0, most = kLeastPicked;
  uint winner = kNone;

  TileList list = lists[tileNumber(tile)];
  for (uint first = list.begin; first < list.end; first += kBatch) {
    if (lane == 0u) searching = 0u;
    barrier();
    if (transmittance > most) atomicAdd(searching, 1u);
    if (first + lane < list.end) collect(lane, listed[first + lane]);
    barrier();
    if (searching == 0u) break;
    uint count = min(kBatch, list.end - first);
    for (uint k = 0u; k < count && transmittance > most; ++k) {
      if (places[k].z > hidden_from || places[k].z < 0.0) continue;
      float alpha = pixelAlpha(k, vec2(pixel) + 0.5);
      if (alpha < kCutoffAlpha) continue;
      if (transmittance * alpha > most) {
        most = transmittance * alpha;
        winner = indices[k];
      }
      transmittance *= 1.0 - alpha;
    }
    barrier();
  }
  if (inside && winner != kNone) picked[texel.y * view.picture.x + texel.x] = winner;
}
