#include "display_settings.hpp"

#include <OgreVector.h>

#include <initializer_list>
#include <rviz_common/properties/bool_property.hpp>
#include <rviz_common/properties/editable_enum_property.hpp>
#include <rviz_common/properties/enum_property.hpp>
#include <rviz_common/properties/float_property.hpp>
#include <rviz_common/properties/vector_property.hpp>
#include <stdexcept>
#include <string>
#include <utility>

#include "rosplat_core/levels/detail.hpp"
#include "rosplat_core/slots/model.hpp"

namespace rosplat {

namespace {

using namespace rviz_common::properties;

constexpr int kAsPublished = -1;

// A text that is no option, as of an older configuration, becomes the preset.
template <typename Value>
EnumProperty* choice(const char* name, const char* preset, const char* description,
                     Property* parent,
                     std::initializer_list<std::pair<std::string, Value>> options) {
  auto* property = new EnumProperty(name, preset, description, parent);
  QStringList known;
  for (const auto& [text, value] : options) {
    known << QString::fromStdString(text);
    property->addOption(known.last(), static_cast<int>(value));
  }
  QObject::connect(property, &Property::changed, property, [property, preset, known] {
    if (!known.contains(property->getString())) property->setString(preset);
  });
  return property;
}

FloatProperty* number(const char* name, float preset, const char* description, Property* parent,
                      float least) {
  auto* property = new FloatProperty(name, preset, description, parent);
  property->setMin(least);
  return property;
}

}  // namespace

DisplaySettings::DisplaySettings(Property* display, std::function<void()> on_change) {
  mode_ = choice<DrawMode>("Draw Mode", "Color", "What a splat is drawn as.", display,
                           {{"Color", DrawMode::kColor},
                            {"Depth", DrawMode::kDepth},
                            {"Billboard", DrawMode::kBillboard},
                            {"Flat Ball", DrawMode::kFlatBall},
                            {"Gaussian Ball", DrawMode::kGaussianBall},
                            {"Normals", DrawMode::kNormals},
                            {"Opacity", DrawMode::kOpacity},
                            {"Age", DrawMode::kAge},
                            {"Channel", DrawMode::kChannel}});
  auto_range_ = new BoolProperty("Auto Range", true,
                                 "Colour from the nearest to the farthest splat drawn.", mode_);
  nearest_ = number("Nearest", 0.0f, "Depth that is drawn red. [m]", mode_, 0.0f);
  farthest_ = number("Farthest", 10.0f, "Depth that is drawn blue. [m]", mode_, 0.0f);
  age_range_ =
      number("Age Range", 10.0f, "Time after which a slot is drawn as old. [s]", mode_, 0.001f);
  channel_ = new EditableEnumProperty(
      "Channel", "",
      "The channel that colours the splats; empty: the map's first. Splats without a value are "
      "grey. Levels of detail have no channels, so all splats are drawn.",
      mode_);
  channel_colours_ = choice<ChannelColours>(
      "Colors", "Auto",
      "Categories: each integer has a colour of its own. Gradient: blue to red. Auto: Categories "
      "where all values are integers.",
      mode_,
      {{"Auto", ChannelColours::kAuto},
       {"Categories", ChannelColours::kCategories},
       {"Gradient", ChannelColours::kGradient}});
  auto_bounds_ =
      new BoolProperty("Autocompute Value Bounds", true,
                       "Colour from the least to the greatest value since the map began.", mode_);
  least_value_ = new FloatProperty("Min Value", 0.0f, "Value that is drawn blue.", mode_);
  most_value_ = new FloatProperty("Max Value", 1.0f, "Value that is drawn red.", mode_);
  detail_ =
      new EditableEnumProperty("Detail", "Full",
                               "How much of the map is drawn. Full: every splat. An error (2 px): "
                               "splats within that width may be one Gaussian. A budget (1M): at "
                               "most so many Gaussians.",
                               display);
  for (const char* example : {"Full", "1 px", "2 px", "4 px", "1M"}) {
    detail_->addOptionStd(example);
  }
  alpha_ = number("Alpha", 1.0f, "Multiplies the opacity of every splat.", display, 0.0f);
  alpha_->setMax(1.0f);
  scale_ = number("Scale", 1.0f, "Multiplies the size of every splat.", display, 0.0f);
  sh_degree_ = choice<int>(
      "SH Degree", "3",
      "Highest band of spherical harmonics to evaluate; 0 leaves out view-dependent colour.",
      display, {{"0", 0}, {"1", 1}, {"2", 2}, {"3", 3}});
  sh_band_ = choice<int>("SH Band", "All", "Draw a single band of spherical harmonics alone.",
                         sh_degree_, {{"All", -1}, {"0", 0}, {"1", 1}, {"2", 2}, {"3", 3}});
  order_ = choice<OrderSource>(
      "Order Source", "Auto",
      "Which depth order is drawn. Auto: the rasterizer's own. Sidecar: the sorter's, while it "
      "answers in time. Off: the order of the slots, which shows what sorting is for.",
      display,
      {{"Auto", OrderSource::kAuto},
       {"Sidecar", OrderSource::kSidecar},
       {"Off", OrderSource::kOff}});
  rasterizer_ = choice<Rasterizer>(
      "Rasterizer", "Auto",
      "What draws the splats. Tiles: the graphics card. Processor: vector instructions, in a "
      "thread beside rviz, which shows the newest finished picture. Auto: Tiles if there is a "
      "graphics card that can draw them, else Processor.",
      display,
      {{"Auto", Rasterizer::kAuto},
       {"Tiles", Rasterizer::kTiles},
       {"Processor", Rasterizer::kProcessor}});
  profile_ = new BoolProperty("Profile", false,
                              "Show the time of each stage of a frame in the Status. Frames then "
                              "wait for the graphics card.",
                              rasterizer_);
  model_ =
      choice<int>("Model", "As Published",
                  "How splats become pixels. EWA: flattened onto the picture. EWA Antialiased: "
                  "and small ones fainter (Mip-Splatting). Ray: evaluated along each pixel's "
                  "ray (3DGUT). Disc: flat, where each ray meets them (2DGS).",
                  display,
                  {{"As Published", kAsPublished},
                   {nameOf(Model::kEwa), int(Model::kEwa)},
                   {nameOf(Model::kEwaAntialiased), int(Model::kEwaAntialiased)},
                   {nameOf(Model::kRay), int(Model::kRay)},
                   {nameOf(Model::kDisc), int(Model::kDisc)}});
  float_blending_ = new BoolProperty(
      "Float Blending", false,
      "Keep pictures in 32-bit instead of 16-bit floats. Tiles blend in 32 bits either way; the "
      "processor always keeps 32.",
      display);
  near_fade_ = number("Near Fade", 0.0f, "Splats closer than this to the near plane fade out. [m]",
                      display, 0.0f);
  clip_ = new BoolProperty("Clip Box", false, "Draw only splats whose mean is in a box.", display);
  clip_centre_ = new VectorProperty("Center", Ogre::Vector3::ZERO,
                                    "Centre of the box in the map's frame. [m]", clip_);
  clip_size_ = new VectorProperty("Size", Ogre::Vector3(1, 1, 1),
                                  "Size of the box along the axes of the map's frame. [m]", clip_);
  clip_handles_ = new BoolProperty(
      "Handles", true,
      "Show the box, and handles for the Interact tool: pull a face, move the middle.", clip_);

  const auto changed = [this, on_change = std::move(on_change)] {
    hideWithoutEffect();
    on_change();
  };
  for (Property* property :
       {static_cast<Property*>(mode_),        static_cast<Property*>(detail_),
        static_cast<Property*>(auto_range_),  static_cast<Property*>(nearest_),
        static_cast<Property*>(farthest_),    static_cast<Property*>(age_range_),
        static_cast<Property*>(channel_),     static_cast<Property*>(channel_colours_),
        static_cast<Property*>(auto_bounds_), static_cast<Property*>(least_value_),
        static_cast<Property*>(most_value_),  static_cast<Property*>(alpha_),
        static_cast<Property*>(scale_),       static_cast<Property*>(sh_degree_),
        static_cast<Property*>(sh_band_),     static_cast<Property*>(order_),
        static_cast<Property*>(rasterizer_),  static_cast<Property*>(profile_),
        static_cast<Property*>(model_),       static_cast<Property*>(float_blending_),
        static_cast<Property*>(near_fade_),   static_cast<Property*>(clip_),
        static_cast<Property*>(clip_centre_), static_cast<Property*>(clip_size_),
        static_cast<Property*>(clip_handles_)}) {
    QObject::connect(property, &Property::changed, property, changed);
  }
  hideWithoutEffect();
}

void DisplaySettings::hideWithoutEffect() {
  const auto mode = static_cast<DrawMode>(mode_->getOptionInt());
  const bool depth = mode == DrawMode::kDepth;
  auto_range_->setHidden(!depth);
  nearest_->setHidden(!depth || auto_range_->getBool());
  farthest_->setHidden(!depth || auto_range_->getBool());
  age_range_->setHidden(mode != DrawMode::kAge);
  const bool channel = mode == DrawMode::kChannel;
  const auto colours = static_cast<ChannelColours>(channel_colours_->getOptionInt());
  const bool bounds = channel && colours != ChannelColours::kCategories;
  channel_->setHidden(!channel);
  channel_colours_->setHidden(!channel);
  auto_bounds_->setHidden(!bounds);
  least_value_->setHidden(!bounds || auto_bounds_->getBool());
  most_value_->setHidden(!bounds || auto_bounds_->getBool());
  clip_centre_->setHidden(!clip_->getBool());
  clip_size_->setHidden(!clip_->getBool());
  clip_handles_->setHidden(!clip_->getBool());
}

void DisplaySettings::offerChannels(const std::vector<Channel>& channels) {
  std::vector<std::string> names;
  for (const Channel& channel : channels) names.push_back(channel.name);
  if (names == channels_) return;
  channel_->clearOptions();
  for (const std::string& name : names) channel_->addOptionStd(name);
  channels_ = std::move(names);
}

std::string DisplaySettings::detailError() const {
  try {
    parseDetail(detail_->getStdString());
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return {};
}

bool DisplaySettings::clipBoxIsDragged() const {
  return clip_->getBool() && clip_handles_->getBool();
}

void DisplaySettings::setClipBox(const ClipBox& box) {
  clip_centre_->setVector({box.centre[0], box.centre[1], box.centre[2]});
  clip_size_->setVector({box.size[0], box.size[1], box.size[2]});
}

RenderSettings DisplaySettings::get() const {
  const auto array = [](const VectorProperty* property) -> std::array<float, 3> {
    const Ogre::Vector3 v = property->getVector();
    return {v.x, v.y, v.z};
  };
  RenderSettings settings;
  settings.mode = static_cast<DrawMode>(mode_->getOptionInt());
  if (!auto_range_->getBool()) {
    settings.depth_range = {nearest_->getFloat(), farthest_->getFloat()};
  }
  settings.age_range = age_range_->getFloat();
  settings.channel = channel_->getStdString();
  settings.channel_colours = static_cast<ChannelColours>(channel_colours_->getOptionInt());
  if (!auto_bounds_->getBool()) {
    settings.channel_range = {least_value_->getFloat(), most_value_->getFloat()};
  }
  try {
    settings.detail = parseDetail(detail_->getStdString());
  } catch (const std::invalid_argument&) {  // detailError() says so
  }
  settings.opacity = alpha_->getFloat();
  settings.scale = scale_->getFloat();
  settings.max_sh_degree = sh_degree_->getOptionInt();
  settings.only_band = sh_band_->getOptionInt();
  settings.order = static_cast<OrderSource>(order_->getOptionInt());
  settings.interactive = true;
  settings.rasterizer = static_cast<Rasterizer>(rasterizer_->getOptionInt());
  settings.profile = profile_->getBool();
  const int model = model_->getOptionInt();
  if (model != kAsPublished) settings.model = modelOf(model);
  settings.float_blending = float_blending_->getBool();
  settings.near_fade = near_fade_->getFloat();
  settings.clip_box = {clip_->getBool(), array(clip_centre_), array(clip_size_)};
  return settings;
}

}  // namespace rosplat
