// Depths of splats as the opaque scene's depth buffer has them.

// Depths beyond the buffer's far plane are clamped to it: nothing can stand behind it.
float ndcDepth(float depth) {
  return min((view.ndc_depth.x * depth + view.ndc_depth.y) / (view.orthographic ? 1.0 : depth), 1.0);
}

float windowDepth(float depth) { return 0.5 * ndcDepth(depth) + 0.5; }
