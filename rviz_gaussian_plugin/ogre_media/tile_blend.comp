// Blends a tile's splats front to back, a pixel an invocation, until nothing behind can be seen. Of
// a list that is cut into segments, it blends one.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Splats { uint splat_of[]; };
layout(std430) readonly buffer Begins { uint begins[]; };
layout(binding = 0) uniform sampler2D scene_depth;
layout(binding = 0) writeonly uniform image2D blended;
#ifdef BEHIND
layout(binding = 1) uniform sampler2D behind_depth;
layout(binding = 1) writeonly uniform image2D blended_behind;
layout(binding = 2) writeonly uniform image2D nearness_behind;  // as in splat_hide.frag
#else
uniform bool later;  // later segments, of tiles that are cut
#endif


const uint kBatch = 256u, kWords = kBatch / 32u;
const uint kParts = 8u;
// Splats whose alphas are found together, without branches: one's memory is waited for with the
// other's. One too many is the first of them once more, of no alpha.
const uint kAtOnce = 4u;
// In place of a peak's logarithm: of what can't be seen, and of balls.
const float kUnseen = -1e3, kFlat2 = 1e3, kShaded2 = 2e3;

// A splat, as the pixels of the tile see it: its falloff is exp2(-u^2 - v^2), where
// u = x * px + y * py + z and v = w * py + rest.x.
shared vec4 forms[kBatch];
shared vec4 rests[kBatch];  // see above; log2 of the peak, or that of a ball; window depth; red
shared vec2 green_blue[kBatch];
#ifdef SHARES
shared float shares_of[kBatch];
#endif
shared uint reaching[kParts][kWords];  // a bit for each splat of the batch
shared uint finished, depths_matter;

// Triangular, so that v is that of a row. [1/px]
void keepForm(uint k, Ellipse e, ivec2 tile) {
  vec4 axes = falloffAxes(e);
  float x = length(axes.xz);
  float y = dot(axes.xz, axes.yw) / x, w = kHalfLog2 * kHalfLog2 / (length(e.major) * e.minor * x);
  vec2 centre = e.centre - vec2(tile * kTile);
  float depth = windowDepth(e.depth);
  float peak = e.kind == kFlat ? kFlat2 : e.kind == kShaded ? kShaded2 : log2(e.opacity);
  vec3 colour = colourOf(e);
  forms[k] = vec4(x, y, -(x * centre.x + y * centre.y), w);
  rests[k] = vec4(-w * centre.y, depth >= 0.0 ? peak : kUnseen, depth, colour.r);
  green_blue[k] = colour.gb;
}

// Notes which parts of a tile a splat of the batch reaches.
void mark(uint k, Ellipse e, ivec2 tile) {
  Outline outline = outlineOf(e);
  outline.centre -= vec2(tile * kTile);
  ivec2 rows = cellsIn(outline.centre.y + vec2(-outline.reach.y, outline.reach.y), float(kPart.y),
                       kTile / kPart.y);
  for (int row = rows.x; row < rows.y; ++row) {
    float top = float(kPart.y * row) + 0.5;
    ivec2 columns = cellsIn(across(outline, top, top + float(kPart.y - 1)), float(kPart.x),
                            kTile / kPart.x);
    for (int column = columns.x; column < columns.y; ++column) {
      atomicOr(reaching[row * (kTile / kPart.x) + column][k / 32u], 1u << (k % 32u));
    }
  }
}

// What a pixel has blended so far.
struct Blended {
  vec3 colour;
  float transmittance;
#ifdef BEHIND
  vec3 colour_behind;
  float transmittance_behind, nearness;
#endif
  float least_transmittance;  // of those that still change what is seen
  bool done;
};

// Blends those of a batch that reach a part. hides: whether the scene may hide some in this tile.
void blendBatch(uint part, vec2 pixel, bool hides, float hidden_from, float behind_until, inout Blended b) {
  for (uint word = 0u; word < kWords; ++word) {
    for (uint bits = reaching[part][word]; bits != 0u && !b.done;) {
      float alphas[kAtOnce], depths[kAtOnce];
      vec3 colours[kAtOnce];
      uint k = 0u;
      for (uint s = 0u; s < kAtOnce; ++s) {
        bool there = bits != 0u;
        if (there) k = 32u * word + uint(findLSB(bits));
        bits &= bits - 1u;
        vec4 form = forms[k], rest = rests[k];
        float u = form.x * pixel.x + (form.y * pixel.y + form.z), v = form.w * pixel.y + rest.x;
        colours[s] = vec3(rest.w, green_blue[k]);
        depths[s] = rest.z;
#ifdef BALLS
        bool ball = rest.y >= kFlat2;
        float falloff = exp2((ball ? 0.0 : rest.y) - u * u - v * v);
        float alpha = ball ? float(falloff >= kBallEdge) : min(kMaxAlpha, falloff);
        if (rest.y == kShaded2) colours[s] *= falloff;
#else
        float alpha = min(kMaxAlpha, exp2(rest.y - u * u - v * v));
#endif
        bool seen = there && alpha >= kCutoffAlpha;
#ifdef SHARES
        alpha = sharedAlpha(alpha, shares_of[k]);
#endif
#ifndef BEHIND
        if (hides) seen = seen && rest.z <= hidden_from;
#endif
        alphas[s] = seen ? alpha : 0.0;
      }
      for (uint s = 0u; s < kAtOnce; ++s) {
#ifdef BEHIND
        if (depths[s] > hidden_from) {
          float light = depths[s] <= behind_until ? b.transmittance_behind * alphas[s] : 0.0;
          b.colour_behind += light * colours[s];
          b.nearness += light * (1.0 - depths[s]);
          b.transmittance_behind -= light;
          continue;
        }
#endif
        float light = b.transmittance * alphas[s];
        b.colour += light * colours[s];
        b.transmittance -= light;
      }
#ifdef BEHIND
      b.done = b.transmittance * b.transmittance_behind < b.least_transmittance;
#else
      b.done = b.transmittance < b.least_transmittance;
#endif
    }
  }
}

void main() {
  uint local = gl_LocalInvocationIndex;
  uint number = workGroup();
#ifndef BEHIND
  uint cut = 0u, segment = number;
  if (later) {
    cut = segments.words[ownerOf(segment)];
    number = segments.words[tileOf(cut)];
  }
#endif
  if (number >= uint(view.tiles.x * view.tiles.y)) return;
  ivec2 tile = tileAt(number);
  uint begin = begins[number], end = begins[number + 1u];
#ifndef BEHIND
  bool is_cut = laterSegments(end - begin) > 0u;
  if (later) {
    begin += first_segment + later_segment * (segment - segments.words[laterOf(cut)]);
    end = min(end, begin + later_segment);
  } else if (is_cut) {
    cut = segments.words[cutOf(number)];
    end = begin + first_segment;
  }
#endif
  if (local == 0u) {
    finished = 0u;
    depths_matter = 0u;
  }
  barrier();

  uint part = local / 32u;
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
  b.least_transmittance = kTransparentInTiles;
  b.done = !inside;
#ifndef BEHIND
  if (later) {
    float first = first_partials[256u * cut + local].a;
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
    if (finished == kBatch) break;
    if (first + local < end) {
      uint splat = splat_of[first + local];
      Ellipse e = ellipse(splat);
      keepForm(local, e, tile);
#ifdef SHARES
      shares_of[local] = shares[splat];
#endif
      mark(local, e, tile);
    }
    barrier();
    if (depths_matter == 0u) {
      blendBatch(part, vec2(in_tile) + 0.5, false, hidden_from, behind_until, b);
    } else {
      blendBatch(part, vec2(in_tile) + 0.5, true, hidden_from, behind_until, b);
    }
    barrier();
  }
#ifdef BEHIND
  if (!inside) return;
  imageStore(blended, texel, vec4(b.colour, 1.0 - b.transmittance));
  imageStore(blended_behind, texel, vec4(b.colour_behind, 1.0 - b.transmittance_behind));
  imageStore(nearness_behind, texel, vec4(b.nearness, 1.0 - b.transmittance_behind, 0.0, 0.0));
#else
  if (!is_cut) {
    if (inside) imageStore(blended, texel, vec4(b.colour, 1.0 - b.transmittance));
    return;
  }
  vec4 partial = vec4(b.colour, b.transmittance);
  if (later) {
    later_partials[256u * segment + local] = partial;
  } else {
    first_partials[256u * cut + local] = partial;
  }
#endif
}
