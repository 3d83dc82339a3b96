#pragma once

// How cameras see maps. Plain types alone, for the kernels and for shaders.

namespace rosplat {

// A camera as the sorters need it, in float32.
struct SortView {
  float rotation[9];              // the positions' frame to camera optical frame, row-major
  float translation[3];           // [m]
  float fx, fy;                   // [px], orthographic [px/m]
  float offset_x, offset_y;       // principal point from the picture's centre [px]
  float half_width, half_height;  // of the picture, with a margin for the low-pass filter [px]
  float slope_x, slope_y;         // growth of a footprint with a splat's extent [px], ortho [px/m]
  float near_clip, far_clip;      // [m]
  bool orthographic;
};

// A group as a camera sees it, relative to the group's origin: splat_groups.glsl has the same
// layout. Rows of matrices end in a translation.
struct GroupView {
  float to_camera[3][4];  // x right, y down, z forward [m]
  float eye[4];           // the camera's position [m]; orthographic: its forward direction
  float to_box[3][4];     // along the map's axes, from the clip box's centre [m]
};

}  // namespace rosplat
