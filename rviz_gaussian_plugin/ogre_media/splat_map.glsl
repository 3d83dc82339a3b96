// How a map is drawn; splat_settings.hpp and view_block.hpp have the same.
layout(std140, binding = 1) uniform Map {
  vec2 depth_range;  // of mode kDepth [m]
  int mode;          // as in DrawMode
  int only_band;     // -1: all
  float scale, opacity;
  float near_fade;   // [m]
  float age_range;   // age that has the colour of old slots [s]

  vec3 box_size;     // of the clip box [m]
  bool clip_to_box;
  vec2 slope;        // as in the sorters' test
  vec2 rise;         // of shares: the error at which it begins [px], and 1 over its range [1/px]
  uint kind;         // of its ellipses
  int sh_degree;
  int model;         // as in Model
  bool cut;          // nodes stand for some of its splats
  float cut_focal;   // [px], orthographic [px/m]
  float channel_least, channel_most, channel_per_range;  // of mode kChannel, as in ChannelColouring
  int channel_colours;                                   // its ChannelKind
} map;
