#pragma once

#include <vector>

#include "map/group_view.hpp"
#include "map/groups.hpp"
#include "map/page_view.hpp"
#include "map/render_settings.hpp"
#include "map/splat_camera.hpp"
#include "rosplat_sorter/depth_order.hpp"

namespace rosplat {

// A group as a camera sees it. Composed in double precision: neither the group's place and origin
// nor the camera's position reaches 32-bit floats.
struct SeenGroup {
  // camera: in the map's frame.
  SeenGroup(const SplatCamera& camera, const Group& group, const ClipBox& box);

  SplatCamera camera;         // in the group's frame
  rosplat_sorter::View view;  // of the picture alone
  GroupView floats;
  PageView pages;
};

// All of a map's, by index.
std::vector<SeenGroup> seenGroups(const SplatCamera& camera, const std::vector<Group>& groups,
                                  const ClipBox& box);

}  // namespace rosplat
