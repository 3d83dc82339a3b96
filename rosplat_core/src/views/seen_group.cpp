#include "rosplat_core/views/seen_group.hpp"

#include "rosplat_core/views/sort_view.hpp"

namespace rosplat {

namespace {

GroupView floatsOf(const SplatCamera& camera, const SortView& view, const Group& group,
                   const ClipBox& box) {
  const std::array<double, 3> origin = group.originOrZero();
  const std::array<double, 3> eye = eyeOf(camera, origin), in_map = group.place(origin);
  GroupView floats{};
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      floats.to_camera[i][k] = view.rotation[3 * i + k];
      floats.to_box[i][k] = static_cast<float>(group.place.rotation[3 * i + k]);
    }
    floats.to_camera[i][3] = view.translation[i];
    floats.to_box[i][3] = static_cast<float>(in_map[i] - box.centre[i]);
    floats.eye[i] = static_cast<float>(camera.orthographic ? camera.rotation[6 + i] : eye[i]);
  }
  return floats;
}

}  // namespace

SeenGroup::SeenGroup(const SplatCamera& map_camera, const Group& group, const ClipBox& box)
    : camera(inFrameOf(group.place, map_camera)),
      view(sortView(camera, group.originOrZero(), 1.0)),
      floats(floatsOf(camera, view, group, box)),
      pages(view, floats, box) {}

std::vector<SeenGroup> seenGroups(const SplatCamera& camera, const std::vector<Group>& groups,
                                  const ClipBox& box) {
  std::vector<SeenGroup> seen;
  seen.reserve(groups.size());
  for (const Group& group : groups) seen.emplace_back(camera, group, box);
  return seen;
}

}  // namespace rosplat
