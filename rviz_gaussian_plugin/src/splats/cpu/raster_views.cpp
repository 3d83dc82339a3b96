// What a picture looks at: its camera and settings as the kernels take them, and the pages that it
// may show.

#include <algorithm>
#include <cmath>

#include "cpu/raster_work.hpp"
#include "map/cut.hpp"
#include "map/sorter_view.hpp"

namespace rosplat {

void CpuRasterizer::Work::setViews(const HostSlots& slots, const MapState& map,
                                   const PictureRequest& request) {
  const SplatCamera& camera = request.camera;
  const RenderSettings& settings = request.settings;
  const ClipBox& box = settings.clip_box;
  groups = seenGroups(camera, slots.index().groups(), box);
  // But for where groups are, they all are seen alike.
  const rosplat_sorter::View view = sorterView(camera, {}, 1.0);
  CullView& c = cull_view;
  c.fx = view.fx;
  c.fy = view.fy;
  c.offset_x = view.offset_x;
  c.offset_y = view.offset_y;
  c.half_width = view.half_width;
  c.half_height = view.half_height;
  c.slope_x = view.slope_x;
  c.slope_y = view.slope_y;
  c.near_clip = view.near_clip;
  c.far_clip = view.far_clip;
  c.orthographic = view.orthographic;
  c.clip_to_box = box.enabled;
  for (int i = 0; i < 3; ++i) c.half_box[i] = 0.5f * box.size[i];

  ProjectView& p = project_view;
  p.fx = view.fx;
  p.fy = view.fy;
  p.cx = static_cast<float>(camera.cx);
  p.cy = static_cast<float>(camera.cy);
  p.width = static_cast<float>(camera.width);
  p.height = static_cast<float>(camera.height);
  const SplatCamera::Whole whole = camera.whole();
  const auto tangents = [&](int axis, double focal, double centre, double size) {
    const double slack = 0.15 * size / focal;  // 0.3 tan(fov / 2)
    p.least_tangent[axis] = static_cast<float>(-centre / focal - slack);
    p.most_tangent[axis] = static_cast<float>((size - centre) / focal + slack);
  };
  tangents(0, camera.fx, whole.cx, whole.width);
  tangents(1, camera.fy, whole.cy, whole.height);
  p.near_clip = view.near_clip;
  p.near_fade = settings.near_fade;
  p.ndc_scale = static_cast<float>(camera.ndc_scale);
  p.ndc_offset = static_cast<float>(camera.ndc_offset);
  p.scale_modifier = settings.scale;
  p.opacity_modifier = settings.opacity;
  p.now = static_cast<float>(request.now);
  p.age_range = settings.age_range;
  p.depth_range[0] = settings.depth_range[0];
  p.depth_range[1] = settings.depth_range[1];
  p.mode = static_cast<int>(settings.mode);
  p.sh_degree = std::min(slots.shDegree(), settings.max_sh_degree);
  p.only_band = settings.only_band;
  p.tiles_across = (camera.width + kTile - 1) / kTile;
  p.tiles_down = (camera.height + kTile - 1) / kTile;
  p.orthographic = camera.orthographic;
  p.antialiased = settings.antialiasing == Antialiasing::kAsTrained
                      ? map.antialiased
                      : settings.antialiasing == Antialiasing::kOn;
  tiles = std::size_t(p.tiles_across) * std::size_t(p.tiles_down);

  ordered = request.order.has_value();
  if (ordered) {
    const std::size_t room = slots.pages().size() * kSlots;
    std::uint32_t* const rank = ranks.reserve(room);
    std::fill_n(rank, room, kNotOrdered);
    const ArrayView<std::uint32_t>& order = *request.order;
    for (std::size_t i = 0; i < order.size; ++i) {
      const SlotPage* const page = slots.index().find(order[i]);
      if (page) {
        rank[std::size_t(page->place) * kSlots + order[i] % kSlots] =
            static_cast<std::uint32_t>(order.size - 1 - i);
      }
    }
  }
}

// Those that may have something in the picture.
void CpuRasterizer::Work::choosePages(const HostSlots& slots, const PictureRequest& request,
                                      double error) {
  pages.clear();
  bounds.clear();
  if (error == 0) {
    for (const SlotPage& page : slots.pages()) {
      if (groups[page.group].pages.mayShow(page)) choose(page, slots.at(page));
    }
    return;
  }
  std::vector<Cut> cuts;
  for (std::size_t group = 0; group < groups.size(); ++group) {
    cuts.emplace_back(groups[group].camera, slots.index().groups()[group].originOrZero(), error,
                      drawsBalls(request.settings.mode));
  }
  const auto mayShow = [&](const SlotPage& page, double own, double parent) {
    return groups[page.group].pages.mayShow(page) && cuts[page.group].mayShow(page, own, parent);
  };
  const Cut cut(request.camera, {}, error, drawsBalls(request.settings.mode));
  CutView& c = cull_view.cut;
  c.focal = static_cast<float>(cut.focal);
  c.from = static_cast<float>(cut.from);
  c.over_span = static_cast<float>(1 / (cut.to - cut.from));
  c.orthographic = cut.orthographic;
  project_view.cut = c;
  for (const SlotPage& page : slots.pages()) {
    const HostSlots::Page& memory = slots.at(page);
    if (!mayShow(page, 0, memory.widest_parent)) continue;
    choose(page, memory);
    if (memory.parents) pages.back().parents = memory.parents->data();
  }
  for (int level = 0; level < kLevels; ++level) {
    const float own = cellSize(level), parent = cellSize(level + 1);
    HostSlots::PerSlot<float>& parents = node_parents[std::size_t(level)];
    parents.fill(parent);
    for (const Levels::Nodes& nodes : request.levels->groups()) {
      for (const auto& page : nodes[std::size_t(level)]) {
        if (!mayShow(page->bounds, own, parent)) continue;
        choose(page->bounds, page->slots);
        pages.back().parents = parents.data();
        pages.back().own_cell = own;
        pages.back().opacity_unit *= kMostNodeOpacity;
      }
    }
  }
}

void CpuRasterizer::Work::choose(const SlotPage& page, const HostSlots::Page& memory) {
  static const std::vector<std::uint32_t> kZeros(std::size_t{7} * kSlots);
  PageSlots& chosen = pages.emplace_back();
  for (int i = 0; i < 3; ++i) chosen.position[i] = memory.position[i].data();
  chosen.extent = memory.extent.data();
  chosen.group = &groups[page.group].floats;
  chosen.words = memory.words[0].data();
  for (int band = 1; band <= kMaxShDegree; ++band) {
    chosen.bands[band] = memory.bands[band] ? memory.bands[band].get() : kZeros.data();
  }
  chosen.parents = nullptr;
  chosen.own_cell = 0;
  chosen.opacity_unit = 1.0f / 65535.0f;
  chosen.first_slot = page.first_slot;
  bounds.push_back(&page);
}

}  // namespace rosplat
