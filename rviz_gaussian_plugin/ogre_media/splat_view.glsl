// The camera in the map's frame, with the sorters' arithmetic, operation by operation.
uniform mat3 rotation;  // map -> camera: x right, y down, z forward
uniform vec3 translation;
uniform bool orthographic;
uniform vec2 clip;  // near, far [m]

vec3 toCamera(vec3 mean) {
  precise vec3 p = ((rotation[0] * mean.x + rotation[1] * mean.y) + rotation[2] * mean.z) + translation;
  return p;
}
