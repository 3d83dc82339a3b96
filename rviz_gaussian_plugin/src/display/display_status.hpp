#pragma once

#include <rviz_common/properties/status_property.hpp>
#include <string>
#include <vector>

#include "drawn_views.hpp"
#include "gaussian_client.hpp"
#include "splat_scene.hpp"

// The lines of a display's Status.
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
// How far a scene file is loaded; `says` is the loader's own sentence.
StatusLine sceneFileStatus(const std::string& says, bool loading, bool failed, const MapState& map);
// What became of the switch to a backend (empty: any), checked against the views' orders.
StatusLine sidecarStatus(const GaussianClient::Status& received, const std::string& wanted,
                         const std::vector<DrawnViews::Report>& views);
// That nobody sorts for Order Source Sidecar.
StatusLine noSorterStatus(const std::string& topic);
// Why pictures may be inaccurate; regimes: SplatScene::hardRegimes().
StatusLine accuracyStatus(const std::vector<std::string>& regimes);
// What is here of the map, what is missing, and what waits to be drawn.
StatusLine mapStatus(const MapState& map, const Backlog& backlog);
// What sorted a frame, and how long it took. `view` is empty for rviz's main view.
StatusLine orderStatus(const FrameReport& frame, const std::string& view);
StatusLine frameStatus(const FrameReport& frame, const std::string& view);
// How long the painter took for the picture that a frame showed, and how old that is.
StatusLine pictureStatus(const FrameReport& frame, const std::string& view);
// How much of the map was drawn, to which error, and the memory of its levels of detail.
StatusLine detailStatus(const Detail& wanted, const FrameReport& frame, std::size_t levels_bytes,
                        const std::string& view);
// Which channel is drawn, and how.
StatusLine channelStatus(const MapState& map, const RenderSettings& settings);
// shared: memory of the renderers, which all maps share.
StatusLine memoryStatus(std::size_t gpu_bytes, std::size_t host_bytes, std::size_t shared_gpu_bytes,
                        std::size_t shared_host_bytes);

}  // namespace rosplat
