#pragma once

#include <vector>

#include "rosplat_core/map/groups.hpp"
#include "rosplat_core/views/group_view.hpp"
#include "rosplat_core/views/page_view.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/sort_view.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A group as a camera sees it. Composed in double precision: the group's place and origin and the
// camera's position reach 32-bit floats only relative to one another.
struct SeenGroup {
  // camera: in the map's frame.
  SeenGroup(const SplatCamera& camera, const Group& group, const ClipBox& box);

  SplatCamera camera;  // in the group's frame
  SortView view;       // without overscan
  GroupView floats;
  PageView pages;
};

// Returns all of a map's groups, by index.
std::vector<SeenGroup> seenGroups(const SplatCamera& camera, const std::vector<Group>& groups,
                                  const ClipBox& box);

}  // namespace rosplat
