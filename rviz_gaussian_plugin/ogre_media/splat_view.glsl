// What the shaders of a frame share; view_block.hpp has the same.
layout(std140) uniform View {
  vec2 clip;                      // near, far [m]
  vec2 focal;                     // [px], orthographic [px/m]
  vec2 offset, half_size;         // as in the sorters' test
  vec2 principal_point;                       // [px]
  vec2 whole_principal_point, whole_picture;  // of the picture that this is a part of, or of this one [px]
  vec2 ndc_depth;                 // ndc.z = (x depth + y) / w
  ivec2 picture;                  // [px]
  ivec2 tiles;                    // in the picture, across and down
  bool orthographic;
  bool top_first;                 // the target's first row is the picture's top
  bool cut;                       // nodes stand for some splats
  float now;                      // as slotAge() reads it
} view;
