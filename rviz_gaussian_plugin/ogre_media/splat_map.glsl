// How the map is drawn whose slots these are; view_block.hpp has the same.
layout(std140, binding = 1) uniform Map {
  vec3 box_size;     // of what is kept of it [m]
  bool clip_to_box;
  vec2 slope;        // as in the sorters' test
  vec2 depth_range;  // of mode kDepth [m]
  vec2 rise;         // of a share: from where [px], and 1 over how far [1/px]
  int mode;          // as in DrawMode
  uint kind;         // of its ellipses
  float near_fade;   // [m]
  float scale_modifier, opacity_modifier;
  int sh_degree;
  int only_band;     // -1: all
  bool antialiased;
  float age_range;   // what is old [s]
  bool cut;          // nodes stand for some of its splats
  float cut_focal;   // [px], orthographic [px/m]
  float channel_least, channel_most, channel_per_range;  // of mode kChannel, as ChannelColouring
  int channel_colours;                                   // the same, its kind
} map;
