#pragma once

namespace rosplat {

// A group as a camera sees it, relative to the group's origin. Plain types alone, for the kernels
// and for shaders: splat_groups.glsl has the same layout. Rows of matrices end in a translation.
struct GroupView {
  float to_camera[3][4];  // x right, y down, z forward [m]
  float eye[4];           // the camera's position [m]; orthographic: its forward direction
  float to_box[3][4];     // along the map's axes, from the clip box's centre [m]
};

}  // namespace rosplat
