// The rasteriser for Python.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "python/held_splats.hpp"
#include "python/module.hpp"
#include "rosplat_core/levels/detail.hpp"
#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/map/host_slots.hpp"
#include "rosplat_core/raster/cpu_rasterizer.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat::python {

namespace {

// A map that the processor alone draws, without OpenGL.
struct CpuRenderer {
  CpuRenderer(unsigned threads, CpuRasterizer::Instructions instructions)
      : CpuRenderer(std::make_shared<ThreadTeam>(threads), instructions) {}
  CpuRenderer(const std::shared_ptr<ThreadTeam>& team, CpuRasterizer::Instructions instructions)
      : levels(team), rasterizer(team, instructions) {}

  GaussianMap map;
  HostSlots slots;
  Levels levels;
  DetailControl detail;
  CpuRasterizer rasterizer;
  SplatPicture picture;
  // A picture that Python has dropped: a later one takes its memory, since the system takes as long
  // to give new memory as a small map takes to be drawn.
  std::shared_ptr<std::vector<float>> spare = std::make_shared<std::vector<float>>();
  RenderSettings settings;
};

// The picture's colours for Python: a copy, or without one where a picture was dropped.
Array<float> lendColour(CpuRenderer& renderer) {
  struct Lent {
    std::vector<float> colour;
    std::shared_ptr<std::vector<float>> spare;
  };
  SplatPicture& picture = renderer.picture;
  auto* const lent = new Lent{{}, renderer.spare};
  const py::capsule capsule(lent, [](void* p) {
    const std::unique_ptr<Lent> dropped(static_cast<Lent*>(p));
    dropped->spare->swap(dropped->colour);
  });
  if (renderer.spare->size() == picture.colour.size()) {
    lent->colour = std::exchange(picture.colour, std::exchange(*renderer.spare, {}));
  } else {
    lent->colour = picture.colour;
  }
  return Array<float>({picture.height, picture.width, 4}, lent->colour.data(), capsule);
}

BatchReport take(CpuRenderer& renderer, const GaussianBatch& batch) {
  return apply(renderer.map, batch, [&](const GaussianEdit& edit) {
    if (edit.clear) renderer.levels.clear();
    renderer.slots.apply(edit, 0);
    renderer.levels.mark(renderer.slots, edit.runs);
  });
}

// Makes the nodes of the whole map; returns how many there are.
std::size_t merge(CpuRenderer& renderer) {
  renderer.levels.advance(renderer.slots, [] { return false; });
  return renderer.levels.nodes();
}

// The renderer's map as a layer of a picture.
PictureLayer layerOf(const CpuRenderer& renderer, const SplatCamera& camera) {
  PictureLayer layer;
  layer.slots = &renderer.slots;
  layer.map = &renderer.map.state();
  layer.camera = camera;
  layer.camera.extent_scale = extentScale(renderer.settings);
  layer.settings = renderer.settings;
  return layer;
}

// The renderer and the order must outlive the request, which refers to them.
PictureRequest requestOf(const CpuRenderer& renderer, const SplatCamera& camera,
                         const std::optional<Array<std::uint32_t>>& order = {}) {
  PictureRequest request;
  request.layers.push_back(layerOf(renderer, camera));
  if (order) request.order = *order;
  return request;
}

// Samples from Python: where tiles begin, x, y and the lens's axis, as in PictureSamples.
using Samples = std::tuple<Array<std::uint32_t>, Array<float>, Array<float>,
                           std::optional<std::array<float, 3>>>;

// A lens from Python: the curve (n, 4), end, widest and by_distance, as in PictureLens.
using LensOfPicture = std::tuple<Array<float>, float, float, bool>;

std::optional<PictureLens> lensOf(const std::optional<LensOfPicture>& given) {
  if (!given) return {};
  const auto& [curve, end, widest, by_distance] = *given;
  return PictureLens{curve, end, widest, by_distance};
}

// Sets a camera's depth buffer to end just beyond opaque objects at depths z [m].
void fitDepthBuffer(SplatCamera& camera, const Array<float>& z) {
  const double near_clip = camera.near_clip;
  double far_clip = near_clip + 1;  // an orthographic buffer is uniform
  std::for_each(z.data(), z.data() + z.size(), [&](float depth) {
    if (std::isfinite(depth)) far_clip = std::max(far_clip, 1.01 * depth);
  });
  far_clip = std::min(far_clip, depthRange(near_clip, camera.far_clip));
  std::tie(camera.ndc_scale, camera.ndc_offset) =
      depthBuffer(camera.orthographic, near_clip, far_clip);
}

// Window depths, in a camera's depth buffer, of opaque objects at depths z (height, width) [m], inf
// where there is none; rounded as the kernels round those of splats.
std::vector<float> windowDepths(const SplatCamera& camera, const Array<float>& z) {
  if (z.ndim() != 2 || z.shape(0) != camera.height || z.shape(1) != camera.width) {
    throw std::invalid_argument("scene_depth: expected float32 (height, width) of the camera");
  }
  const float scale = float(camera.ndc_scale), offset = float(camera.ndc_offset);
  std::vector<float> depths(std::size_t(z.size()));
  std::transform(z.data(), z.data() + z.size(), depths.begin(), [&](float depth) {
    if (!(camera.orthographic ? depth == depth : depth > 0)) {
      throw std::invalid_argument("scene_depth: expected depths in front of the camera, or inf");
    }
    if (depth == std::numeric_limits<float>::infinity()) return 1.0f;
    const float ndc = (scale * depth + offset) / (camera.orthographic ? 1.0f : depth);
    return std::clamp(0.5f * ndc + 0.5f, 0.0f, 1.0f);
  });
  return depths;
}

py::dict drawOnCpu(CpuRenderer& renderer, SplatCamera camera, bool mean_depth, bool median_depth,
                   const std::optional<Array<std::uint32_t>>& order,
                   const std::vector<CpuRenderer*>& beside, const std::optional<Samples>& samples,
                   const std::optional<LensOfPicture>& lens,
                   const std::optional<Array<float>>& scene_depth) {
  if (mean_depth && median_depth) throw std::invalid_argument("a picture has one depth");
  if (order && !beside.empty()) throw std::invalid_argument("an order is of one map alone");
  if (int(samples.has_value()) + int(lens.has_value()) + int(scene_depth.has_value()) > 1) {
    throw std::invalid_argument("a picture has one of samples, lens and scene_depth");
  }
  std::vector<float> opaque;
  if (scene_depth) {
    fitDepthBuffer(camera, *scene_depth);
    opaque = windowDepths(camera, *scene_depth);
  }
  PictureRequest request = requestOf(renderer, camera, order);
  for (const CpuRenderer* other : beside) request.layers.push_back(layerOf(*other, camera));
  if (mean_depth) request.depth = PictureDepth::kMean;
  if (median_depth) request.depth = PictureDepth::kMedian;
  request.planes = true;
  request.scene_depth = opaque;
  if (samples) {
    const auto& [begins, x, y, axis] = *samples;
    request.samples = PictureSamples{begins, x, y, axis};
  }
  request.lens = lensOf(lens);
  SplatPicture& picture = renderer.picture;
  {
    const py::gil_scoped_release release;
    if (!(renderer.settings.drawnDetail() == Detail{}) && !order) {
      merge(renderer);
      PictureLayer& layer = request.layers.front();
      layer.levels = &renderer.levels;
      renderer.detail.expect(
          {renderer.levels.samples(), camera, renderer.slots.index().groups(), layer.settings});
      layer.error = renderer.detail.choose(layer.settings);
    }
    renderer.rasterizer.draw(request, picture);
    PictureLayer& layer = request.layers.front();
    while (layer.levels) {
      const SplatPicture::OfLayer& drawn = picture.layers.front();
      const std::optional<double> error = renderer.detail.adjust(drawn.error, drawn.drawn);
      if (!error) break;
      layer.error = *error;
      renderer.rasterizer.draw(request, picture);
    }
  }
  py::dict drawn("splats"_a = picture.layers.front().drawn,
                 "error"_a = picture.layers.front().error,
                 "detail_error"_a = request.layers.front().levels ? renderer.detail.problem() : "",
                 "profile"_a = picture.profile, "bytes"_a = renderer.rasterizer.bytes());
  if (samples) {  // by sample
    const auto n = static_cast<py::ssize_t>(picture.colour.size() / 4);
    drawn["colour"] = toArray(picture.colour, {n, 4});
    if (!picture.depth.empty()) drawn["depth"] = toArray(picture.depth, {n, 1});
    return drawn;
  }
  drawn["colour"] = lendColour(renderer);
  if (!picture.depth.empty()) {
    drawn["depth"] = toArray(picture.depth, {picture.height, picture.width, 1});
  }
  return drawn;
}

void contributeOnCpu(CpuRenderer& renderer, const SplatCamera& camera, Contributions& sums,
                     const std::optional<Array<float>>& residual,
                     const std::optional<LensOfPicture>& lens) {
  PictureRequest request = requestOf(renderer, camera);
  if (residual) request.residual = *residual;
  request.lens = lensOf(lens);
  const py::gil_scoped_release release;
  renderer.rasterizer.contribute(request, sums);
}

// The slots that contribute, and their weights, energies and errors, all of which are 0 afterwards:
// a view sees few of a large map's.
py::tuple takeSeen(Contributions& sums) {
  std::vector<std::uint32_t> slots;
  std::array<std::vector<float>, 3> seen;
  const std::array<std::vector<float>*, 3> all{&sums.weight, &sums.energy, &sums.error};
  for (std::size_t slot = 0; slot < sums.weight.size(); ++slot) {
    if (sums.weight[slot] == 0) continue;
    slots.push_back(static_cast<std::uint32_t>(slot));
    for (std::size_t i = 0; i < all.size(); ++i) {
      seen[i].push_back(std::exchange((*all[i])[slot], 0.0f));
    }
  }
  const auto n = static_cast<py::ssize_t>(slots.size());
  return py::make_tuple(toArray(std::move(slots), {n}), toArray(std::move(seen[0]), {n}),
                        toArray(std::move(seen[1]), {n}), toArray(std::move(seen[2]), {n}));
}

Array<std::uint32_t> pickOnCpu(CpuRenderer& renderer, const SplatCamera& camera) {
  const PictureRequest request = requestOf(renderer, camera);
  std::vector<std::uint32_t> picked;
  {
    const py::gil_scoped_release release;
    for (const PickedSplat& splat : renderer.rasterizer.pick(request)) picked.push_back(splat.slot);
  }
  return toArray(std::move(picked), {camera.height, camera.width});
}

// The splats of a map as they are drawn: slots, groups, and arrays by splat, in the map's frame but
// for the harmonics, which are in the group's.
py::dict splatsOf(const CpuRenderer& renderer) {
  std::vector<std::uint32_t> slots, groups;
  std::vector<double> positions;
  std::vector<float> orientations, scales, opacities, sh;
  for (const SlotPage& page : renderer.slots.pages()) {
    std::vector<std::uint32_t> of_page(HostSlots::kSlots);
    std::iota(of_page.begin(), of_page.end(), page.first_slot);
    for (const SplatValues& splat : renderer.slots.read(of_page)) {
      if (!(splat.opacity > 0)) continue;
      slots.push_back(splat.slot);
      groups.push_back(splat.group);
      positions.insert(positions.end(), splat.position.begin(), splat.position.end());
      orientations.insert(orientations.end(), splat.orientation.begin(), splat.orientation.end());
      scales.insert(scales.end(), splat.scale.begin(), splat.scale.end());
      opacities.push_back(splat.opacity);
      sh.insert(sh.end(), splat.sh.begin(), splat.sh.end());
    }
  }
  const auto n = static_cast<py::ssize_t>(slots.size());
  py::dict splats = arraysOf(std::move(positions), std::move(orientations), std::move(scales),
                             std::move(opacities), std::move(sh));
  splats["slots"] = toArray(std::move(slots), {n});
  splats["groups"] = toArray(std::move(groups), {n});
  return splats;
}

// The nodes of a level of a group, by ascending cells: the width and corners of the cells [m], and
// the nodes' values as of splats.
py::dict nodesOf(const CpuRenderer& renderer, int level, std::uint32_t group) {
  const int degree = renderer.slots.shDegree();
  std::vector<double> corners;
  std::vector<float> positions, orientations, scales, opacities, sh;
  const auto add = [](auto& all, const auto& values) {
    all.insert(all.end(), values.begin(), values.end());
  };
  const std::vector<Group>& groups = renderer.slots.index().groups();
  const auto of = std::find_if(groups.begin(), groups.end(),
                               [group](const Group& other) { return other.number == group; });
  const auto index = static_cast<std::size_t>(of - groups.begin());
  static const Levels::Nodes kNone;
  const Levels::Nodes& nodes =
      index < renderer.levels.groups().size() ? renderer.levels.groups()[index] : kNone;
  for (const auto& page : nodes.at(static_cast<std::size_t>(level))) {
    for (std::size_t i = 0; i < page->cells.size(); ++i) {
      const Node node = page->node(i, degree);
      const Splat splat = unpackSlot(node.packed.words.data());
      add(corners, cornerOf(node.cell));
      add(positions, splat.position);
      add(orientations, splat.orientation);
      add(scales, splat.scale);
      opacities.push_back(kMostNodeOpacity * splat.opacity);
      add(sh, splat.color);
      add(sh, unpackHarmonics(node.packed.words.data(), degree, node.packed.bandWords()));
    }
  }
  const auto n = static_cast<py::ssize_t>(opacities.size());
  py::dict nodes_of = arraysOf(std::move(positions), std::move(orientations), std::move(scales),
                               std::move(opacities), std::move(sh));
  nodes_of["size"] = cellSize(level);
  nodes_of["corners"] = toArray(std::move(corners), {n, 3});
  return nodes_of;
}

// A picture of splats, premultiplied RGBA, and their depths, over bytes and depths of what is
// opaque, or nothing; and where splats are a surface: where they hide half of what is behind.
py::tuple overOpaque(const Array<float>& colour, const Array<float>& depth,
                     const std::optional<Array<std::uint8_t>>& below,
                     const std::optional<Array<float>>& below_depth) {
  const py::ssize_t height = colour.shape(0), width = colour.shape(1), n = height * width;
  const auto fits = [&](const py::array& of, py::ssize_t channels) {
    return of.size() == n * channels && of.shape(0) == height && of.shape(1) == width;
  };
  if (colour.ndim() != 3 || !fits(colour, 4) || depth.ndim() != 2 || !fits(depth, 1) ||
      (below && (below->ndim() != 3 || !fits(*below, 3))) ||
      (below_depth && (below_depth->ndim() != 2 || !fits(*below_depth, 1)))) {
    throw std::invalid_argument("expected pictures of one size");
  }
  Array<std::uint8_t> bytes({height, width, py::ssize_t{3}});
  Array<float> depths({height, width});
  py::array_t<bool> surfaces({height, width});
  const float* const rgba = colour.data();
  const float* const z = depth.data();
  const std::uint8_t* const behind = below ? below->data() : nullptr;
  const float* const farther = below_depth ? below_depth->data() : nullptr;
  std::uint8_t* const out = bytes.mutable_data();
  float* const out_z = depths.mutable_data();
  bool* const surface = surfaces.mutable_data();
  using Pixel = float __attribute__((vector_size(4 * sizeof(float))));
  using Integers = int __attribute__((vector_size(4 * sizeof(int))));
  const Pixel none{}, most = none + 255.0f;
  for (py::ssize_t i = 0; i < n; ++i) {
    Pixel pixel, under{};
    std::memcpy(&pixel, rgba + 4 * i, sizeof(pixel));
    const float alpha = pixel[3];
    if (behind) {
      const std::uint8_t* const of = behind + 3 * i;
      under = Pixel{float(of[0]), float(of[1]), float(of[2])};
    }
    pixel = 255.0f * pixel + (1.0f - alpha) * under + 0.5f;
    pixel = pixel > none ? pixel : none;
    pixel = pixel < most ? pixel : most;
    const auto whole = __builtin_convertvector(pixel, Integers);
    for (int c = 0; c < 3; ++c) out[3 * i + c] = std::uint8_t(whole[c]);
    const float beyond = farther ? farther[i] : std::numeric_limits<float>::infinity();
    surface[i] = alpha >= 0.5f;
    out_z[i] = surface[i] ? z[i] : beyond;
  }
  return py::make_tuple(std::move(bytes), std::move(depths), std::move(surfaces));
}

}  // namespace

void defineRendering(py::module_& module) {
  module.def("over_opaque", &overOpaque, "colour"_a, "depth"_a, "below"_a = py::none(),
             "below_depth"_a = py::none(),
             "A picture of splats (height, width, 4), premultiplied, over RGB in bytes of what is\n"
             "opaque: RGB in bytes, and depths, of splats where they hide half of what is behind;\n"
             "and where they do.");
  py::enum_<DrawMode>(module, "DrawMode")
      .value("COLOR", DrawMode::kColor)
      .value("DEPTH", DrawMode::kDepth)
      .value("BILLBOARD", DrawMode::kBillboard)
      .value("FLAT_BALL", DrawMode::kFlatBall)
      .value("GAUSSIAN_BALL", DrawMode::kGaussianBall)
      .value("NORMALS", DrawMode::kNormals)
      .value("OPACITY", DrawMode::kOpacity)
      .value("AGE", DrawMode::kAge)
      .value("CHANNEL", DrawMode::kChannel);
  py::enum_<ChannelColours>(module, "ChannelColours")
      .value("AUTO", ChannelColours::kAuto)
      .value("CATEGORIES", ChannelColours::kCategories)
      .value("GRADIENT", ChannelColours::kGradient);
  py::enum_<OrderSource>(module, "OrderSource")
      .value("AUTO", OrderSource::kAuto)
      .value("SIDECAR", OrderSource::kSidecar)
      .value("OFF", OrderSource::kOff);
  py::enum_<Rasterizer>(module, "Rasterizer")
      .value("AUTO", Rasterizer::kAuto)
      .value("TILES", Rasterizer::kTiles)
      .value("PROCESSOR", Rasterizer::kProcessor);
  py::class_<ClipBox>(module, "ClipBox")
      .def(py::init<>())
      .def_readwrite("enabled", &ClipBox::enabled)
      .def_readwrite("centre", &ClipBox::centre)
      .def_readwrite("size", &ClipBox::size);
  py::class_<RenderSettings>(module, "RenderSettings")
      .def(py::init<>())
      .def_readwrite("mode", &RenderSettings::mode)
      .def_readwrite("max_sh_degree", &RenderSettings::max_sh_degree)
      .def_readwrite("only_band", &RenderSettings::only_band)
      .def_readwrite("interactive", &RenderSettings::interactive)
      .def_readwrite("depths", &RenderSettings::depths)
      .def_readwrite("scale", &RenderSettings::scale)
      .def_readwrite("opacity", &RenderSettings::opacity)
      .def_property(
          "model",
          [](const RenderSettings& s) {
            return s.model ? std::optional(int(*s.model)) : std::nullopt;
          },
          [](RenderSettings& s, std::optional<int> model) {
            s.model = model ? std::optional(modelOf(*model)) : std::nullopt;
          })
      .def_readwrite("order", &RenderSettings::order)
      .def_readwrite("rasterizer", &RenderSettings::rasterizer)
      .def_readwrite("profile", &RenderSettings::profile)
      .def_property(
          "detail", [](const RenderSettings& s) { return toText(s.detail); },
          [](RenderSettings& s, const std::string& text) { s.detail = parseDetail(text); })
      .def_readwrite("clip_box", &RenderSettings::clip_box)
      .def_readwrite("near_fade", &RenderSettings::near_fade)
      .def_property(
          "depth_range",
          [](const RenderSettings& s) {
            return std::pair(s.depth_range.least, s.depth_range.most);
          },
          [](RenderSettings& s, const std::pair<float, float>& range) {
            s.depth_range = {range.first, range.second};
          })
      .def_readwrite("age_range", &RenderSettings::age_range)
      .def_readwrite("channel", &RenderSettings::channel)
      .def_readwrite("channel_colours", &RenderSettings::channel_colours)
      .def_readwrite("channel_range", &RenderSettings::channel_range);
  py::class_<SplatCamera>(module, "SplatCamera")
      .def(py::init(&cameraOf), "position"_a, "orientation"_a, "projection"_a, "fx"_a, "fy"_a,
           "cx"_a, "cy"_a, "width"_a, "height"_a, "near"_a = 0.01, "far"_a = 1e10)
      .def("crop", &crop, "left"_a, "top"_a, "width"_a, "height"_a);
  py::enum_<CpuRasterizer::Instructions>(module, "Instructions")
      .value("PLAIN", CpuRasterizer::Instructions::kPlain)
      .value("AVX2", CpuRasterizer::Instructions::kAvx2)
      .value("AVX512", CpuRasterizer::Instructions::kAvx512)
      .value("BEST", CpuRasterizer::Instructions::kBest);
  const auto sums_of = [](const std::vector<float>& values) {
    return Array<float>(static_cast<py::ssize_t>(values.size()), values.data());
  };
  py::class_<Contributions>(module, "Contributions")
      .def(py::init<>())
      .def_property_readonly("weight", [=](const Contributions& c) { return sums_of(c.weight); })
      .def_property_readonly("energy", [=](const Contributions& c) { return sums_of(c.energy); })
      .def_property_readonly("error", [=](const Contributions& c) { return sums_of(c.error); })
      .def_property_readonly("residual",
                             [=](const Contributions& c) { return sums_of(c.residual); })
      .def(
          "take_seen", &takeSeen,
          "The slots with a weight, and their weights, energies and errors; all are 0 afterwards.");
  py::class_<CpuRenderer> cpu_renderer(module, "CpuRenderer");
  defineApply(cpu_renderer, take);
  cpu_renderer
      .def(py::init<unsigned, CpuRasterizer::Instructions>(), "threads"_a = 0,
           "instructions"_a = CpuRasterizer::Instructions::kBest)
      .def_readwrite("settings", &CpuRenderer::settings)
      .def("draw", &drawOnCpu, "camera"_a, "mean_depth"_a = false, "median_depth"_a = false,
           "order"_a = py::none(), "beside"_a = std::vector<CpuRenderer*>(),
           "samples"_a = py::none(), "lens"_a = py::none(), "scene_depth"_a = py::none(),
           "Draws the map; and, in one order with it, those of other renderers in the same frame. "
           "scene_depth: depths of opaque objects (height, width) [m], which hide splats whose "
           "centres are behind them; inf where there is none.")
      .def("merge", &merge, py::call_guard<py::gil_scoped_release>())
      .def("splats", &splatsOf)
      .def("nodes", &nodesOf, "level"_a, "group"_a = 0)
      .def_property_readonly("levels_bytes", [](CpuRenderer& r) { return r.levels.bytes(); })
      .def("pick", &pickOnCpu, "camera"_a)
      .def("contribute", &contributeOnCpu, "camera"_a, "sums"_a, "residual"_a = py::none(),
           "lens"_a = py::none())
      .def_property_readonly(
          "map", [](CpuRenderer& r) -> GaussianMap& { return r.map; },
          py::return_value_policy::reference_internal, "The books of the map that it draws.")
      .def_property_readonly("map_bytes", [](CpuRenderer& r) { return r.slots.bytes(); })
      .def_property_readonly("instructions",
                             [](CpuRenderer& r) { return r.rasterizer.instructions(); });
}

}  // namespace rosplat::python
