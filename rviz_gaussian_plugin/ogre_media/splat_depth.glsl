// Splats in the opaque scene's depth buffer.
uniform vec2 ndc_depth;  // ndc.z = (x depth + y) / w
uniform bool orthographic;

// What lies beyond the buffer's far plane is as far as that: nothing can stand behind it.
float ndcDepth(float depth) {
  return min((ndc_depth.x * depth + ndc_depth.y) / (orthographic ? 1.0 : depth), 1.0);
}

float windowDepth(float depth) { return 0.5 * ndcDepth(depth) + 0.5; }
