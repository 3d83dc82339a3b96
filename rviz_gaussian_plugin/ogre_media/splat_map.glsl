// How a map is drawn; view_block.hpp has the same.
layout(std140, binding = 1) uniform Map {
  vec3 box_size;     // of the clip box [m]
  bool clip_to_box;
  vec2 slope;        // as in the sorters' test
  vec2 depth_range;  // of mode kDepth [m]
  vec2 rise;         // of shares: the error at which it begins [px], and 1 over its range [1/px]
  int mode;          // as in DrawMode
  uint kind;         // of its ellipses
  float near_fade;   // [m]
  float scale_modifier, opacity_modifier;
  int sh_degree;
  int only_band;     // -1: all
  int model;         // as in Model
  float age_range;   // age that has the colour of old slots [s]
  bool cut;          // nodes stand for some of its splats
  float cut_focal;   // [px], orthographic [px/m]
  float channel_least, channel_most, channel_per_range;  // of mode kChannel, as in ChannelColouring
  int channel_colours;                                   // its ChannelKind
} map;
