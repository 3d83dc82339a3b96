// Stages that prepare a picture: the kernels' camera and settings, and the pages that may be seen.

#include <algorithm>

#include "raster/raster_work.hpp"
#include "rosplat_core/levels/cut.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/views/channel_colouring.hpp"
#include "rosplat_core/views/sort_view.hpp"

namespace rosplat {

void CpuRasterizer::Work::setView(const PictureLayer& layer, const PictureRequest& request,
                                  SeenLayer& seen) {
  const SplatCamera& camera = layer.camera;
  const RenderSettings& settings = layer.settings;
  const ClipBox& box = settings.clip_box;
  SplatCamera of_pages = camera;
  if (request.samples) of_pages.near_clip = -camera.far_clip;  // the lens clips single splats
  seen.groups = seenGroups(of_pages, layer.slots->index().groups(), box);
  seen.error = layer.levels ? layer.error : 0;
  seen.drawn = 0;
  CullView& c = seen.cull;
  static_cast<SortView&>(c) = sortView(camera, {}, 1.0);
  c.through_lens = request.samples || request.lens;
  c.in_cone = request.lens.has_value();
  if (request.samples) {
    c.by_distance = !request.samples->axis;
    if (!c.by_distance) std::copy_n(request.samples->axis->begin(), 3, c.axis);
  }
  if (request.lens) {
    c.by_distance = request.lens->by_distance;
    c.axis[0] = c.axis[1] = 0, c.axis[2] = 1;
    c.cone = 1 - 2 * request.lens->widest;
    c.extent_scale = static_cast<float>(camera.extent_scale);
  }
  c.clip_to_box = box.enabled;
  for (int i = 0; i < 3; ++i) c.half_box[i] = 0.5f * box.size[i];

  ProjectView& p = seen.project;
  static_cast<SplatSettings&>(p) = settings;
  p.fx = c.fx;
  p.fy = c.fy;
  p.cx = static_cast<float>(camera.cx);
  p.cy = static_cast<float>(camera.cy);
  p.width = static_cast<float>(camera.width);
  p.height = static_cast<float>(camera.height);
  const SplatCamera::Whole whole = camera.whole();
  const auto tangents = [&](int axis, double focal, double centre, double size) {
    const double slack = kTangentSlack * size / focal;
    p.least_tangent[axis] = static_cast<float>(-centre / focal - slack);
    p.most_tangent[axis] = static_cast<float>((size - centre) / focal + slack);
  };
  tangents(0, camera.fx, whole.cx, whole.width);
  tangents(1, camera.fy, whole.cy, whole.height);
  p.near_clip = c.near_clip;
  p.ndc_scale = static_cast<float>(camera.ndc_scale);
  p.ndc_offset = static_cast<float>(camera.ndc_offset);
  p.now = static_cast<float>(request.now);
  const ChannelColouring channel = colouringOf(layer.map->channels, settings);
  seen.channel = channel.channel;
  p.channel_colours = channel.kind;
  p.channel_least = channel.least;
  p.channel_most = channel.most;
  p.channel_per_range = channel.per_range;
  p.sh_degree = std::min(layer.slots->shDegree(), settings.max_sh_degree);
  p.orthographic = camera.orthographic;
  p.through_lens = c.through_lens;
  p.between = request.samples ? 0.5f : 0.0f;
  p.lens = {};
  if (request.lens) {
    const auto parts = int(request.lens->curve.size / 4);
    p.lens = {request.lens->curve.data, parts, request.lens->end, float(parts) / request.lens->end};
  }
  p.model = settings.drawnModel(layer.map->model);
}

void CpuRasterizer::Work::setOrder(const HostSlots& slots, const ArrayView<std::uint32_t>& order) {
  const std::size_t room = slots.pages().size() * kSlots;
  std::uint32_t* const rank = ranks.reserve(room);
  std::fill_n(rank, room, kNotOrdered);
  for (std::size_t i = 0; i < order.size; ++i) {
    const SlotPage* const page = slots.index().find(order[i]);
    if (page) {
      rank[std::size_t(page->place) * kSlots + order[i] % kSlots] =
          static_cast<std::uint32_t>(order.size - 1 - i);
    }
  }
}

// Chooses the pages and nodes of a layer that the picture may show.
void CpuRasterizer::Work::choosePages(const PictureLayer& layer, std::uint32_t number) {
  const HostSlots& slots = *layer.slots;
  SeenLayer& seen = layers[number];
  const std::vector<SeenGroup>& groups = seen.groups;
  const double error = seen.error;
  if (error == 0) {
    for (const SlotPage& page : slots.pages()) {
      if (seen.cull.in_cone || groups[page.group].pages.mayShow(page)) {
        choose(page, slots.at(page), number);
      }
    }
    return;
  }
  const bool blends = layer.settings.blendsLevels();
  std::vector<Cut> cuts;
  for (std::size_t group = 0; group < groups.size(); ++group) {
    cuts.emplace_back(groups[group].camera, slots.index().groups()[group].originOrZero(), error,
                      blends);
  }
  const auto mayShow = [&](const SlotPage& page, float own, float parent) {
    return (seen.cull.in_cone || groups[page.group].pages.mayShow(page)) &&
           cuts[page.group].mayShow(page, own, parent);
  };
  const Cut cut(layer.camera, {}, error, blends);
  CutView& c = seen.cull.cut;
  c.focal = static_cast<float>(cut.focal);
  c.from = static_cast<float>(cut.from);
  c.over_span = static_cast<float>(1 / (cut.to - cut.from));
  c.orthographic = cut.orthographic;
  seen.project.cut = c;
  for (const SlotPage& page : slots.pages()) {
    const HostSlots::Page& memory = slots.at(page);
    if (!mayShow(page, 0, memory.widest_parent)) continue;
    choose(page, memory, number);
    if (memory.parents) pages.back().slots.parents = memory.parents->data();
  }
  for (int level = 0; level <= kLevels; ++level) {
    node_parents[std::size_t(level)].fill(cellSize(level));
  }
  for (int level = 0; level < kLevels; ++level) {
    const float own = cellSize(level);
    for (const Levels::Nodes& nodes : layer.levels->groups()) {
      const float parent = parentSize(nodes, level);
      const auto& parents = node_parents[std::size_t(parent < kBoundless ? level + 1 : kLevels)];
      for (const auto& page : nodes[std::size_t(level)]) {
        if (!mayShow(page->bounds, own, parent)) continue;
        choose(page->bounds, page->slots, number);
        PageSlots& chosen = pages.back().slots;
        chosen.parents = parents.data();
        chosen.own_cell = own;
        chosen.opacity_unit *= kMostNodeOpacity;
      }
    }
  }
}

void CpuRasterizer::Work::choose(const SlotPage& page, const HostSlots::Page& memory,
                                 std::uint32_t layer) {
  const auto first_index = static_cast<std::uint32_t>(pages.size() * kSlots);
  pages.push_back({{}, &page, layer});
  PageSlots& chosen = pages.back().slots;
  for (int i = 0; i < 3; ++i) chosen.position[i] = memory.position[i].data();
  chosen.extent = memory.extent.data();
  chosen.group = &layers[layer].groups[page.group].floats;
  static_assert(cpu::kMostAppearanceWords == (appearanceWords(kMaxShDegree) + 3) / 4 * 4);
  chosen.appearances = memory.appearances.get();
  chosen.appearance_words = appearanceWords(memory.sh_degree);
  for (int band = 1; band <= kMaxShDegree; ++band) {
    chosen.bands[band] = band <= memory.sh_degree ? appearanceBand(band) : 0;
  }
  static const auto kNoValues = [] {
    HostSlots::PerSlot<float> values;
    values.fill(kNoValue);
    return values;
  }();
  const std::size_t channel = layers[layer].channel;
  const bool has_values = channel < kMostChannels && memory.channels[channel];
  chosen.channel = has_values ? memory.channels[channel]->data() : kNoValues.data();
  chosen.parents = nullptr;
  chosen.own_cell = 0;
  chosen.opacity_unit = 1.0f / 65535.0f;
  chosen.first_index = first_index;
}

PickedSplat CpuRasterizer::Work::splatOf(std::uint32_t index) const {
  const SeenPage& seen = pages[index / kSlots];
  return {seen.layer, seen.page->first_slot + index % kSlots};
}

}  // namespace rosplat
