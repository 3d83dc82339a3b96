#pragma once

namespace rosplat {

// What a camera sees of a group, relative to the group's origin: plain types alone, for the
// kernels, and for shaders, as splat_groups.glsl has it. Rows of matrices end in a translation.
struct GroupView {
  float to_camera[3][4];  // x right, y down, z forward [m]
  float eye[4];           // the camera; orthographic: its forward direction
  float to_box[3][4];     // along the map's axes, from the centre of what is kept of it [m]
};

}  // namespace rosplat
