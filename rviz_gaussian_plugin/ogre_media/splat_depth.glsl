// Splats in the opaque scene's depth buffer.

// What lies beyond the buffer's far plane is as far as that: nothing can stand behind it.
float ndcDepth(float depth) {
  return min((view.ndc_depth.x * depth + view.ndc_depth.y) / (view.orthographic ? 1.0 : depth), 1.0);
}

float windowDepth(float depth) { return 0.5 * ndcDepth(depth) + 0.5; }
