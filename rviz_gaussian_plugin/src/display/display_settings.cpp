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

}  // namespace

// A text that is no option, as of an older configuration, becomes the preset.
template <typename Value>
EnumProperty* DisplaySettings::choice(const char* name, const char* preset, const char* description,
                                      Property* parent,
                                      std::initializer_list<std::pair<std::string, Value>> options,
                                      Value RenderSettings::* field) {
  auto* property = added(new EnumProperty(name, preset, description, parent));
  QStringList known;
  for (const auto& [text, value] : options) {
    known << QString::fromStdString(text);
    property->addOption(known.last(), static_cast<int>(value));
  }
  QObject::connect(property, &Property::changed, property, [property, preset, known] {
    if (!known.contains(property->getString())) property->setString(preset);
  });
  if (field) {
    reads_.push_back([property, field](RenderSettings& settings) {
      settings.*field = static_cast<Value>(property->getOptionInt());
    });
  }
  return property;
}

FloatProperty* DisplaySettings::number(const char* name, float preset, const char* description,
                                       Property* parent, float least,
                                       float RenderSettings::* field) {
  auto* property = added(new FloatProperty(name, preset, description, parent));
  property->setMin(least);
  if (field) {
    reads_.push_back([=](RenderSettings& settings) { settings.*field = property->getFloat(); });
  }
  return property;
}

BoolProperty* DisplaySettings::flag(const char* name, bool preset, const char* description,
                                    Property* parent, bool RenderSettings::* field) {
  auto* property = added(new BoolProperty(name, preset, description, parent));
  if (field) {
    reads_.push_back([=](RenderSettings& settings) { settings.*field = property->getBool(); });
  }
  return property;
}

template <typename Added>
Added* DisplaySettings::added(Added* property) {
  properties_.push_back(property);
  return property;
}

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
                            {"Channel", DrawMode::kChannel}},
                           &RenderSettings::mode);
  auto_range_ =
      flag("Auto Range", true, "Colour from the nearest to the farthest splat drawn.", mode_);
  nearest_ = number("Nearest", 0.0f, "Depth that is drawn red. [m]", mode_, 0.0f);
  farthest_ = number("Farthest", 10.0f, "Depth that is drawn blue. [m]", mode_, 0.0f);
  age_range_ = number("Age Range", 10.0f, "Time after which a slot is drawn as old. [s]", mode_,
                      0.001f, &RenderSettings::age_range);
  channel_ = added(new EditableEnumProperty(
      "Channel", "",
      "The channel that colours the splats; empty: the map's first. Splats without a value are "
      "grey. Levels of detail have no channels, so all splats are drawn.",
      mode_));
  channel_colours_ = choice<ChannelColours>(
      "Colors", "Auto",
      "Categories: each integer has a colour of its own. Gradient: blue to red. Auto: Categories "
      "where all values are integers.",
      mode_,
      {{"Auto", ChannelColours::kAuto},
       {"Categories", ChannelColours::kCategories},
       {"Gradient", ChannelColours::kGradient}},
      &RenderSettings::channel_colours);
  auto_bounds_ = flag("Autocompute Value Bounds", true,
                      "Colour from the least to the greatest value since the map began.", mode_);
  least_value_ = added(new FloatProperty("Min Value", 0.0f, "Value that is drawn blue.", mode_));
  most_value_ = added(new FloatProperty("Max Value", 1.0f, "Value that is drawn red.", mode_));
  detail_ = added(
      new EditableEnumProperty("Detail", "Full",
                               "How much of the map is drawn. Full: every splat. An error (2 px): "
                               "splats within that width may be one Gaussian. A budget (1M): at "
                               "most so many Gaussians.",
                               display));
  for (const char* example : {"Full", "1 px", "2 px", "4 px", "1M"}) {
    detail_->addOptionStd(example);
  }
  number("Alpha", 1.0f, "Multiplies the opacity of every splat.", display, 0.0f,
         &RenderSettings::opacity)
      ->setMax(1.0f);
  number("Scale", 1.0f, "Multiplies the size of every splat.", display, 0.0f,
         &RenderSettings::scale);
  Property* const sh_degree = choice<int>(
      "SH Degree", "3",
      "Highest band of spherical harmonics to evaluate; 0 leaves out view-dependent colour.",
      display, {{"0", 0}, {"1", 1}, {"2", 2}, {"3", 3}}, &RenderSettings::max_sh_degree);
  choice<int>("SH Band", "All", "Draw a single band of spherical harmonics alone.", sh_degree,
              {{"All", -1}, {"0", 0}, {"1", 1}, {"2", 2}, {"3", 3}}, &RenderSettings::only_band);
  choice<OrderSource>(
      "Order Source", "Auto",
      "Which depth order is drawn. Auto: the rasterizer's own. Sidecar: the sorter's, while it "
      "answers in time. Off: the order of the slots, which shows what sorting is for.",
      display,
      {{"Auto", OrderSource::kAuto},
       {"Sidecar", OrderSource::kSidecar},
       {"Off", OrderSource::kOff}},
      &RenderSettings::order);
  Property* const rasterizer = choice<Rasterizer>(
      "Rasterizer", "Auto",
      "What draws the splats. Tiles: the graphics card. Processor: vector instructions, in a "
      "thread beside rviz, which shows the newest finished picture. Auto: Tiles if there is a "
      "graphics card that can draw them, else Processor.",
      display,
      {{"Auto", Rasterizer::kAuto},
       {"Tiles", Rasterizer::kTiles},
       {"Processor", Rasterizer::kProcessor}},
      &RenderSettings::rasterizer);
  flag("Profile", false,
       "Show the time of each stage of a frame in the Status. Frames then "
       "wait for the graphics card.",
       rasterizer, &RenderSettings::profile);
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
  number("Near Fade", 0.0f, "Splats closer than this to the near plane fade out. [m]", display,
         0.0f, &RenderSettings::near_fade);
  clip_ = flag("Clip Box", false, "Draw only splats whose mean is in a box.", display);
  clip_centre_ = added(new VectorProperty("Center", Ogre::Vector3::ZERO,
                                          "Centre of the box in the map's frame. [m]", clip_));
  clip_size_ =
      added(new VectorProperty("Size", Ogre::Vector3(1, 1, 1),
                               "Size of the box along the axes of the map's frame. [m]", clip_));
  clip_handles_ =
      flag("Handles", true,
           "Show the box, and handles for the Interact tool: pull a face, move the middle.", clip_);

  const auto changed = [this, on_change = std::move(on_change)] {
    hideWithoutEffect();
    on_change();
  };
  for (Property* property : properties_) {
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
  settings.interactive = true;
  for (const auto& read : reads_) read(settings);
  if (!auto_range_->getBool()) {
    settings.depth_range = {nearest_->getFloat(), farthest_->getFloat()};
  }
  settings.channel = channel_->getStdString();
  if (!auto_bounds_->getBool()) {
    settings.channel_range = {least_value_->getFloat(), most_value_->getFloat()};
  }
  try {
    settings.detail = parseDetail(detail_->getStdString());
  } catch (const std::invalid_argument&) {  // detailError() says so
  }
  const int model = model_->getOptionInt();
  if (model != kAsPublished) settings.model = modelOf(model);
  settings.clip_box = {clip_->getBool(), array(clip_centre_), array(clip_size_)};
  return settings;
}

}  // namespace rosplat
