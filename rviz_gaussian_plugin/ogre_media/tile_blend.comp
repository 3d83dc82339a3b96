// Blends a tile's splats front to back, a pixel an invocation, until nothing behind can be seen.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Splats { uint splat_of[]; };
layout(std430) readonly buffer Begins { uint begins[]; };
layout(binding = 0) uniform sampler2D scene_depth;
layout(binding = 0) writeonly uniform image2D blended;
#ifdef BEHIND
layout(binding = 1) uniform sampler2D behind_depth;
layout(binding = 1) writeonly uniform image2D blended_behind;
layout(binding = 2) writeonly uniform image2D nearness_behind;  // as in splat_hide.frag
#endif


const uint kBatch = 256u, kWords = kBatch / 32u;
// 32 lanes blend a block of a tile's pixels, and skip the splats that don't reach it.
const ivec2 kPart = ivec2(8, 4);
const uint kParts = 8u;
// Splats whose alphas are found together, without branches: one's memory is waited for with the
// other's. One too many is the first of them once more, of no alpha.
const uint kAtOnce = 2u;

shared vec4 places[kBatch];  // centre [px], window depth, peakOf()
shared vec4 axes[kBatch];    // falloffAxes()
shared vec3 colours[kBatch];
#ifdef SHARES
shared float shares_of[kBatch];
#endif
shared uint reaching[kParts][kWords];  // a bit for each splat of the batch
shared uint finished;

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

void main() {
  ivec2 tile = groupTile();
  if (tile.y >= view.tiles.y) return;
  uint local = gl_LocalInvocationIndex;
  uint part = local / 32u;
  ivec2 in_part = ivec2(int(local) % kPart.x, int(local % 32u) / kPart.x);
  ivec2 pixel = tile * kTile + ivec2(part % 2u, part / 2u) * kPart + in_part;
  ivec2 texel = texelOf(pixel, view.picture.y, view.top_first);
  bool inside = all(lessThan(pixel, view.picture));
  bool done = !inside;
  float hidden_from = inside ? texelFetch(scene_depth, texel, 0).r : 0.0;
  vec3 colour = vec3(0.0);
  float transmittance = 1.0;
#ifdef BEHIND
  float behind_until = inside ? texelFetch(behind_depth, texel, 0).r : 0.0;
  vec3 colour_behind = vec3(0.0);
  float transmittance_behind = 1.0, nearness = 0.0;
#endif

  uint index = uint(tile.y * view.tiles.x + tile.x);
  uint begin = begins[index], end = begins[index + 1u];
  if (local == 0u) finished = 0u;
  barrier();
  if (done) atomicAdd(finished, 1u);
  for (uint first = begin; first < end; first += kBatch) {
    if (local < kParts * kWords) reaching[local / kWords][local % kWords] = 0u;
    barrier();
    if (first + local < end) {
      uint splat = splat_of[first + local];
      Ellipse e = ellipse(splat);
      places[local] = vec4(e.centre, windowDepth(e.depth), peakOf(e));
      axes[local] = falloffAxes(e);
      colours[local] = colourOf(e);
#ifdef SHARES
      shares_of[local] = shares[splat];
#endif
      mark(local, e, tile);
    }
    barrier();
    for (uint word = 0u; word < kWords; ++word) {
      for (uint bits = reaching[part][word]; bits != 0u && !done;) {
        uint ks[kAtOnce];
        float alphas[kAtOnce];
        vec3 splats[kAtOnce];
        for (uint s = 0u; s < kAtOnce; ++s) {
          bool there = bits != 0u;
          uint k = there ? 32u * word + uint(findLSB(bits)) : ks[0];
          bits &= bits - 1u;
          vec4 place = places[k];
          float falloff = falloffAt(axes[k], vec2(pixel) + 0.5 - place.xy);
          float alpha = alphaAt(place.w, falloff);
          bool seen = there && alpha >= kCutoffAlpha;
#ifdef SHARES
          alpha = sharedAlpha(alpha, shares_of[k]);
#endif
#ifndef BEHIND
          seen = seen && place.z <= hidden_from && place.z >= 0.0;
#endif
          ks[s] = k;
          alphas[s] = seen ? alpha : 0.0;
          splats[s] = colours[k] * (place.w == kShadedPeak ? falloff : 1.0);
        }
        for (uint s = 0u; s < kAtOnce; ++s) {
          float alpha = done ? 0.0 : alphas[s];
#ifdef BEHIND
          float depth = places[ks[s]].z;
          if (alpha > 0.0 && depth > hidden_from && depth <= behind_until) {
            colour_behind += transmittance_behind * alpha * splats[s];
            nearness += transmittance_behind * alpha * (1.0 - depth);
            transmittance_behind *= 1.0 - alpha;
            done = transmittance * transmittance_behind < kTransparentInTiles;
            continue;
          }
          if (depth > hidden_from || depth < 0.0) continue;
#endif
          colour += transmittance * alpha * splats[s];
          transmittance *= 1.0 - alpha;
          done = done || transmittance < kTransparentInTiles;
        }
        if (done) atomicAdd(finished, 1u);
      }
    }
    barrier();
    if (finished == kBatch) break;
  }
  if (!inside) return;
  imageStore(blended, texel, vec4(colour, 1.0 - transmittance));
#ifdef BEHIND
  imageStore(blended_behind, texel, vec4(colour_behind, 1.0 - transmittance_behind));
  imageStore(nearness_behind, texel, vec4(nearness, 1.0 - transmittance_behind, 0.0, 0.0));
#endif
}
