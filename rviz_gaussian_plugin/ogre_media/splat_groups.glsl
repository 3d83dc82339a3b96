// What the view sees of the maps' groups, map by map; group_view.hpp has the same.
struct Group {
  vec4 to_camera[3];  // rows: x right, y down, z forward [m]
  vec4 eye;           // the camera; orthographic: its forward direction
  vec4 to_box[3];     // rows: along the map's axes, from the centre of the clip box [m]
};
layout(std430) readonly buffer Groups { Group groups[]; };

mat3 rotationOf(vec4 rows[3]) { return transpose(mat3(rows[0].xyz, rows[1].xyz, rows[2].xyz)); }

// With the sorters' arithmetic, operation by operation.
vec3 transformed(vec4 rows[3], vec3 mean) {
  mat3 rotation = rotationOf(rows);
  precise vec3 p = ((rotation[0] * mean.x + rotation[1] * mean.y) + rotation[2] * mean.z) +
                   vec3(rows[0].w, rows[1].w, rows[2].w);
  return p;
}
