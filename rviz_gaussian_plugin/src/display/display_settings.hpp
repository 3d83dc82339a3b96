#pragma once

#include <functional>
#include <initializer_list>
#include <string>
#include <utility>
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
  using BoolProperty = rviz_common::properties::BoolProperty;
  using EditableEnumProperty = rviz_common::properties::EditableEnumProperty;
  using EnumProperty = rviz_common::properties::EnumProperty;
  using FloatProperty = rviz_common::properties::FloatProperty;
  using Property = rviz_common::properties::Property;
  using VectorProperty = rviz_common::properties::VectorProperty;

  // These add a property. field: what its value is of the settings; null: get() reads it.
  template <typename Value>
  EnumProperty* choice(const char* name, const char* preset, const char* description,
                       Property* parent,
                       std::initializer_list<std::pair<std::string, Value>> options,
                       Value RenderSettings::* field = nullptr);
  FloatProperty* number(const char* name, float preset, const char* description, Property* parent,
                        float least, float RenderSettings::* field = nullptr);
  BoolProperty* flag(const char* name, bool preset, const char* description, Property* parent,
                     bool RenderSettings::* field = nullptr);
  template <typename Added>
  Added* added(Added* property);

  void hideWithoutEffect();

  std::vector<Property*> properties_;                        // all of them
  std::vector<std::function<void(RenderSettings&)>> reads_;  // those with a field

  EnumProperty* mode_;
  EditableEnumProperty* detail_;
  BoolProperty* auto_range_;
  FloatProperty* nearest_;
  FloatProperty* farthest_;
  FloatProperty* age_range_;
  EditableEnumProperty* channel_;
  std::vector<std::string> channels_;  // offered
  EnumProperty* channel_colours_;
  BoolProperty* auto_bounds_;
  FloatProperty* least_value_;
  FloatProperty* most_value_;
  EnumProperty* model_;
  BoolProperty* clip_;
  VectorProperty* clip_centre_;
  VectorProperty* clip_size_;
  BoolProperty* clip_handles_;
};

}  // namespace rosplat
