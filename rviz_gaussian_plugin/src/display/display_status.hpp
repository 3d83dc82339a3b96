#pragma once

#include <rviz_common/properties/status_property.hpp>
#include <string>
#include <vector>

#include "drawn_views.hpp"
#include "gaussian_client.hpp"
#include "splat_scene.hpp"

// What the Status of a display says of what it knows.
namespace rosplat {

struct StatusLine {
  rviz_common::properties::StatusProperty::Level level;
  std::string name, text;

  bool operator==(const StatusLine& o) const {
    return level == o.level && name == o.name && text == o.text;
  }
};

// Whether batches arrive, and if not, why.
StatusLine topicStatus(const GaussianClient::Status& received);
// How far the loading of a scene file is; `says` is the loader's own sentence.
StatusLine sceneFileStatus(const std::string& says, bool loading, bool failed, const MapState& map);
// What became of the wish for a backend (empty: any), beside what sorted the views.
StatusLine sidecarStatus(const GaussianClient::Status& received, const std::string& wanted,
                         const std::vector<DrawnViews::Report>& views);
// Why pictures may be worse than elsewhere: SplatScene::hardRegimes().
StatusLine accuracyStatus(const std::vector<std::string>& regimes);
// What there is of the map, what is missing, and what waits to be drawn.
StatusLine mapStatus(const MapState& map, const Backlog& backlog);
// Who sorted a frame, and what it took; `view` is empty for rviz's own.
StatusLine orderStatus(const FrameReport& frame, const std::string& view);
StatusLine frameStatus(const FrameReport& frame, const std::string& view);
// What was drawn of the map, to which error, and what its levels of detail take.
StatusLine detailStatus(const Detail& wanted, const FrameReport& frame, std::size_t levels_bytes,
                        const std::string& view);
// Which channel is drawn, and how.
StatusLine channelStatus(const MapState& map, const RenderSettings& settings);
// shared: by what all maps are drawn with.
StatusLine memoryStatus(std::size_t gpu_bytes, std::size_t host_bytes, std::size_t shared_gpu_bytes,
                        std::size_t shared_host_bytes);

}  // namespace rosplat
