// What the shaders of a frame share; view_block.hpp has the same.
layout(std140) uniform View {
  vec3 box_size;  // of what is kept of the map [m]
  bool clip_to_box;
  bool orthographic;
  int mode;         // as in DrawMode
  float near_fade;  // [m]
  vec2 clip;            // near, far [m]
  vec2 focal;           // [px], orthographic [px/m]
  vec2 offset, half_size, slope;  // as in the sorters' test
  vec2 principal_point;                       // [px]
  vec2 whole_principal_point, whole_picture;  // of which the picture is a part, or itself [px]
  ivec2 picture;                              // [px]
  ivec2 tiles;                                // in the picture, across and down
  vec2 ndc_depth;                             // ndc.z = (x depth + y) / w
  vec2 depth_range;  // of mode kDepth [m]; empty: that of what is drawn
  vec2 rise;         // of a share: from where [px], and 1 over how far [1/px]
  float scale_modifier, opacity_modifier;
  int sh_degree;
  int only_band;     // -1: all
  bool antialiased;
  bool top_first;    // the target's first row is the picture's top
  float now;         // as slotAge() reads it
  float age_range;   // what is old [s]
  float cut_focal;   // [px], orthographic [px/m]
  bool cut;          // nodes stand for some splats
  float channel_least, channel_most, channel_per_range;  // of mode kChannel, as ChannelColouring
  int channel_colours;  // the same, its kind
} view;
