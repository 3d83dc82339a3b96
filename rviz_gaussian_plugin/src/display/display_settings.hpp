#pragma once

#include <functional>
#include <string>
#include <vector>

#include "rosplat_core/views/render_settings.hpp"

namespace rviz_common::properties {
class BoolProperty;
class EditableEnumProperty;
class EnumProperty;
class FloatProperty;
class Property;
class VectorProperty;
}  // namespace rviz_common::properties

namespace rosplat {

// The properties of a display that decide how a map is drawn.
class DisplaySettings {
 public:
  // Adds the properties to a display; on_change is called whenever one of them changes.
  DisplaySettings(rviz_common::properties::Property* display, std::function<void()> on_change);

  RenderSettings get() const;
  // Offers the map's channels as options of the property Channel.
  void offerChannels(const std::vector<Channel>& channels);
  // Why Detail is Full instead of the text that was typed; empty if that text is valid.
  std::string detailError() const;

  // Whether the clip box has handles.
  bool clipBoxIsDragged() const;
  void setClipBox(const ClipBox& box);

 private:
  void hideWithoutEffect();

  rviz_common::properties::EnumProperty* mode_;
  rviz_common::properties::EditableEnumProperty* detail_;
  rviz_common::properties::BoolProperty* auto_range_;
  rviz_common::properties::FloatProperty* nearest_;
  rviz_common::properties::FloatProperty* farthest_;
  rviz_common::properties::FloatProperty* age_range_;
  rviz_common::properties::EditableEnumProperty* channel_;
  std::vector<std::string> channels_;  // offered
  rviz_common::properties::EnumProperty* channel_colours_;
  rviz_common::properties::BoolProperty* auto_bounds_;
  rviz_common::properties::FloatProperty* least_value_;
  rviz_common::properties::FloatProperty* most_value_;
  rviz_common::properties::EnumProperty* sh_degree_;
  rviz_common::properties::EnumProperty* sh_band_;
  rviz_common::properties::EnumProperty* order_;
  rviz_common::properties::EnumProperty* rasterizer_;
  rviz_common::properties::BoolProperty* profile_;
  rviz_common::properties::FloatProperty* scale_;
  rviz_common::properties::FloatProperty* alpha_;
  rviz_common::properties::FloatProperty* near_fade_;
  rviz_common::properties::EnumProperty* model_;
  rviz_common::properties::BoolProperty* float_blending_;
  rviz_common::properties::BoolProperty* clip_;
  rviz_common::properties::VectorProperty* clip_centre_;
  rviz_common::properties::VectorProperty* clip_size_;
  rviz_common::properties::BoolProperty* clip_handles_;
};

}  // namespace rosplat
