// Blends a tile's splats front to back, a pixel an invocation, until nothing behind can be seen. If the
// tile's list is cut into segments, a work group blends one of these.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Listed { uint listed[]; };
layout(std430) readonly buffer Lists { TileList lists[]; };
layout(binding = 0) uniform sampler2D scene_depth;
layout(binding = 0) writeonly uniform image2D blended;
#ifdef BEHIND
layout(binding = 1) uniform sampler2D behind_depth;
layout(binding = 1) writeonly uniform image2D blended_behind;
layout(binding = 2) writeonly uniform image2D nearness_behind;  // as in splat_hide.frag
#endif
#ifdef SEGMENTS
uniform bool later;  // work groups blend later segments, not the region's tiles or first segments
#endif

const uint kBatch = 128u, kWords = kBatch / 32u;
const uint kParts = 8u;
// Splats whose alphas are computed together, without branches, so that their loads wait at the same time.
// Surplus splats have an alpha of 0.
const uint kAtOnce = 4u;
// In place of the logarithm of a peak: for splats that can't be seen, and for balls.
const float kUnseen = -1e3, kFlat2 = 1e3, kShaded2 = 2e3;

// A splat, as the pixels of the tile see it: its falloff is exp2(-u^2 - v^2), where
// u = x * px + y * py + z and v = w * py + rest.x.
shared vec4 forms[kBatch];
// x: see `forms`; y: log2 of the peak, or what stands for it; z, w: packedColour(). Most pixels read a splat in
// two loads of 16 bytes: each further load takes a fifth longer.
shared uvec4 rests[kBatch];
shared float depths[kBatch];  // in the window
#ifdef DEPTHS
shared vec3 planes_of[kBatch];  // what a pixel's x, y and 1 add to the depth [m]
#endif
#ifdef RAYS
shared vec4 tilts[kBatch];
#endif
#ifdef DISCS
shared vec2 spots[kBatch];  // far away where there is none
#endif
#ifdef SHARES
shared float shares_of[kBatch];
#endif
shared uint reaching[kParts][kWords];  // a bit for each splat of the batch
shared uint reached[kParts][kBatch];   // the numbers of these splats in the batch, without gaps
shared uint finished, depths_matter;

// What is blended of a splat.
#ifdef DEPTHS
uvec2 packedColour(Ellipse e) { return uvec2(floatBitsToUint(e.depth), 0u); }
vec3 unpackedColour(uvec2 words) { return vec3(uintBitsToFloat(words.x), 0.0, 0.0); }
#else
uvec2 packedColour(Ellipse e) {
  vec3 colour = colourOf(e);
  return uvec2(packHalf2x16(colour.rg), packHalf2x16(vec2(colour.b, 0.0)));
}
vec3 unpackedColour(uvec2 words) { return vec3(unpackHalf2x16(words.x), unpackHalf2x16(words.y).x); }
#endif

// Keeps a splat's form, triangular, so that v depends on the row alone. [1/px]
void keepForm(uint k, Ellipse e, ivec2 tile) {
  vec4 axes = falloffAxes(e);
  float x = length(axes.xz);
  float y = dot(axes.xz, axes.yw) / x, w = kHalfLog2 * kHalfLog2 / (length(e.major) * e.minor * x);
  vec2 centre = e.centre - vec2(tile * kTile);
  float depth = windowDepth(e.depth);
  float peak = e.kind == kFlat ? kFlat2 : e.kind == kShaded ? kShaded2 : log2(e.opacity);
  forms[k] = vec4(x, y, -(x * centre.x + y * centre.y), w);
  rests[k] = uvec4(floatBitsToUint(vec2(-w * centre.y, depth >= 0.0 ? peak : kUnseen)), packedColour(e));
  depths[k] = depth;
#ifdef RAYS
  tilts[k] = tiltOf(e, vec2(tile * kTile));
#endif
#ifdef DISCS
  spots[k] = e.has_spot ? spotOf(e) - vec2(tile * kTile) : vec2(kEverywhere);
#endif
}

// Notes which parts of a tile a splat of the batch reaches.
void mark(uint k, Ellipse e, ivec2 tile) {
  Outline outline = seenFrom(outlineOf(e), vec2(tile * kTile));
  ivec2 rows = rowsOf(outline, kPart.y, kTile / kPart.y);
  for (int row = rows.x; row < rows.y; ++row) {
    ivec2 columns = columnsOf(outline, row, kPart, kTile / kPart.x);
    for (int column = columns.x; column < columns.y; ++column) {
      atomicOr(reaching[row * (kTile / kPart.x) + column][k / 32u], 1u << (k % 32u));
    }
  }
}

// Lists, as one of a part's 32 lanes, which splats of the batch reach the part. Returns how many do.
uint listReaching(uint part, uint lane) {
  uint count = 0u;
  for (uint word = 0u; word < kWords; ++word) {
    uint bits = reaching[part][word], before = bits & ((1u << lane) - 1u);
    if ((bits >> lane & 1u) != 0u) reached[part][count + uint(bitCount(before))] = 32u * word + lane;
    count += uint(bitCount(bits));
  }
  if (lane < -count % kAtOnce) reached[part][count + lane] = 0u;
  return count;
}

// What a pixel has blended so far.
struct Blended {
  vec3 colour;
  float transmittance;
#ifdef BEHIND
  vec3 colour_behind;
  float transmittance_behind, nearness;
#endif
  float least_transmittance;  // below this, splats behind can't be seen
  bool done;
};

// Blends the listed splats of a batch that reach a part. hides: whether the scene may hide some in this tile.
void blendBatch(uint part, uint count, vec2 pixel, bool hides, float hidden_from, float behind_until,
                inout Blended b) {
  for (uint first = 0u; first < count && !b.done; first += kAtOnce) {
    float alphas[kAtOnce], window_depths[kAtOnce];
    vec3 colours[kAtOnce];
    for (uint s = 0u; s < kAtOnce; ++s) {
      uint k = reached[part][first + s];
      vec4 form = forms[k];
      uvec4 rest = rests[k];
      float u = form.x * pixel.x + (form.y * pixel.y + form.z);
      float v = form.w * pixel.y + uintBitsToFloat(rest.x), peak = uintBitsToFloat(rest.y);
      colours[s] = unpackedColour(rest.zw);
#ifdef DEPTHS
      vec3 plane = planes_of[k];
      colours[s].x = max(colours[s].x + (plane.x * pixel.x + (plane.y * pixel.y + plane.z)), 0.0);
#endif
#ifdef BALLS
      bool ball = peak >= kFlat2;
      float top = ball ? 0.0 : peak;
#else
      float top = peak;
#endif
#ifdef RAYS
      vec4 tilt = tilts[k];
      float square = u * u + v * v, along = alongRay(tilt, pixel);
#ifdef DEPTHS
      float depth = colours[s].x;
      colours[s].x *= depthOnRay(tilt, along, square);
#endif
      square = squareOfRay(tilt, along, square);
#ifdef DISCS
      float in_spot = squareInSpot(pixel - spots[k]);
#ifdef DEPTHS
      if (in_spot < square) colours[s].x = depth;
#endif
      square = min(square, in_spot);
#endif
      float falloff = exp2(top - square);
#else
      float falloff = exp2(top - u * u - v * v);
#endif
#ifdef BALLS
      float alpha = ball ? float(falloff >= kBallEdge) : min(kMaxAlpha, falloff);
#ifndef DEPTHS
      if (peak == kShaded2) colours[s] *= falloff;
#endif
#else
      float alpha = min(kMaxAlpha, falloff);
#endif
      bool seen = first + s < count && alpha >= kCutoffAlpha;
#ifdef SHARES
      alpha = sharedAlpha(alpha, shares_of[k]);
#endif
#ifdef BEHIND
      window_depths[s] = depths[k];
#else
      if (hides) seen = seen && depths[k] <= hidden_from;
#endif
      alphas[s] = seen ? alpha : 0.0;
    }
    for (uint s = 0u; s < kAtOnce; ++s) {
#ifdef BEHIND
      float depth = window_depths[s];
      if (depth > hidden_from) {
        float light = depth <= behind_until ? b.transmittance_behind * alphas[s] : 0.0;
        b.colour_behind += light * colours[s];
        b.nearness += light * (1.0 - depth);
        b.transmittance_behind -= light;
        continue;
      }
#endif
      float light = b.transmittance * alphas[s];
#ifdef MEDIAN
      if (b.transmittance > 0.5 && b.transmittance - light <= 0.5) b.colour = colours[s];
#else
      b.colour += light * colours[s];
#endif
      b.transmittance -= light;
    }
#ifdef BEHIND
    b.done = b.transmittance * b.transmittance_behind < b.least_transmittance;
#else
    b.done = b.transmittance < b.least_transmittance;
#endif
  }
}

void main() {
  uint local = gl_LocalInvocationIndex;
  ivec2 tile = groupTile();
#ifdef SEGMENTS
  uint segment = workGroup();
  if (later) {
    if (segment >= segments.count) return;
    tile = tileAt(segments.tiles[segment]);
  }
#endif
  if (tile.y >= view.tiles.y) return;
  uint number = tileNumber(tile);
  TileList list = lists[number];
  uint begin = list.begin, end = list.end;
#ifdef SEGMENTS
  if (later) {
    if (segment == list.first_segment) return;
    begin += kFirstSegment + kLaterSegment * (segment - list.first_segment - 1u);
    end = min(end, begin + kLaterSegment);
  } else if (list.first_segment != kNone) {
    segment = list.first_segment;
    end = begin + kFirstSegment;
  }
#endif
  if (local == 0u) {
    finished = 0u;
    depths_matter = 0u;
  }
  barrier();

  uint part = local / 32u, lane = local % 32u;
  ivec2 in_tile = pixelInTile(local), pixel = tile * kTile + in_tile;
  ivec2 texel = texelOf(pixel, view.picture.y, view.top_first);
  bool inside = all(lessThan(pixel, view.picture));
  float hidden_from = inside ? texelFetch(scene_depth, texel, 0).r : 0.0;
  float behind_until = 0.0;
  Blended b;
  b.colour = vec3(0.0);
  b.transmittance = 1.0;
#ifdef BEHIND
  behind_until = inside ? texelFetch(behind_depth, texel, 0).r : 0.0;
  b.colour_behind = vec3(0.0);
  b.transmittance_behind = 1.0;
  b.nearness = 0.0;
#endif
#ifdef MEDIAN
  b.least_transmittance = 0.5;
#else
  b.least_transmittance = kTransparentInTiles;
#endif
  b.done = !inside;
#ifdef SEGMENTS
  if (later) {
    float first = partials[256u * list.first_segment + local].a;
    b.least_transmittance /= first;
    b.done = b.done || first < kTransparentInTiles;
  }
#endif
  if (inside && hidden_from < 1.0) atomicOr(depths_matter, 1u);
  bool counted = false;
  for (uint first = begin; first < end; first += kBatch) {
    if (b.done && !counted) {
      atomicAdd(finished, 1u);
      counted = true;
    }
    if (local < kParts * kWords) reaching[local / kWords][local % kWords] = 0u;
    barrier();
    if (finished == 256u) break;
    if (local < kBatch && first + local < end) {
      uint splat = listed[first + local];
      Ellipse e = ellipse(splat);
      keepForm(local, e, tile);
#ifdef DEPTHS
      planes_of[local] = vec3(planes[splat], -dot(planes[splat], e.centre - vec2(tile * kTile)));
#endif
#ifdef SHARES
      shares_of[local] = view.cut ? shares[splat] : 1.0;
#endif
      mark(local, e, tile);
    }
    barrier();
    uint count = listReaching(part, lane);
    barrier();
    if (depths_matter == 0u) {
      blendBatch(part, count, vec2(in_tile) + 0.5, false, hidden_from, behind_until, b);
    } else {
      blendBatch(part, count, vec2(in_tile) + 0.5, true, hidden_from, behind_until, b);
    }
    barrier();
  }
#ifdef BEHIND
  if (!inside) return;
  imageStore(blended, texel, vec4(b.colour, 1.0 - b.transmittance));
  imageStore(blended_behind, texel, vec4(b.colour_behind, 1.0 - b.transmittance_behind));
  imageStore(nearness_behind, texel, vec4(b.nearness, 1.0 - b.transmittance_behind, 0.0, 0.0));
#else
#ifdef SEGMENTS
  if (list.first_segment != kNone) {
    partials[256u * segment + local] = vec4(b.colour, b.transmittance);
    return;
  }
#endif
  if (inside) imageStore(blended, texel, vec4(b.colour, 1.0 - b.transmittance));
#endif
}
