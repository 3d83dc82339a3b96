#pragma once

#include <vector>

#include "rosplat_core/map/groups.hpp"
#include "rosplat_core/views/group_view.hpp"
#include "rosplat_core/views/page_view.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/sort_view.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A group as a camera sees it. Composed in double precision: neither the group's place and origin
// nor the camera's position reaches 32-bit floats.
struct SeenGroup {
  // camera: in the map's frame.
  SeenGroup(const SplatCamera& camera, const Group& group, const ClipBox& box);

  SplatCamera camera;  // in the group's frame
  SortView view;       // of the picture alone
  GroupView floats;
  PageView pages;
};

// All of a map's, by index.
std::vector<SeenGroup> seenGroups(const SplatCamera& camera, const std::vector<Group>& groups,
                                  const ClipBox& box);

}  // namespace rosplat
