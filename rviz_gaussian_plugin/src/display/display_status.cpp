#include "display_status.hpp"

#include <iomanip>
#include <sstream>
#include <utility>

#include "rosplat_core/views/channel_colouring.hpp"

namespace rosplat {

namespace {

using rviz_common::properties::StatusProperty;

// Older orders are a warning: in a second of slow motion, half of the view may be new. [s]
constexpr double kOldOrder = 1.0;

template <typename... Parts>
std::string concat(const Parts&... parts) {
  std::ostringstream text;
  text << std::fixed << std::setprecision(1);
  (text << ... << parts);
  return text.str();
}

std::string joined(const std::vector<std::string>& parts, const char* by = ", ") {
  std::string text;
  for (const std::string& part : parts) text += (text.empty() ? "" : by) + part;
  return text;
}

std::string nameOf(const char* line, const std::string& view) {
  return view.empty() ? line : concat(line, " (", view, ")");
}

// A time [s], in digits that one can tell apart while they change.
std::string inMs(double seconds) {
  return concat(std::setprecision(seconds < 0.01 ? 1 : 0), seconds * 1e3, " ms");
}

bool isBy(const FrameReport& frame, const std::string& sorter) {
  return frame.order_source.rfind(sorter, 0) == 0;
}

}  // namespace

StatusLine topicStatus(const GaussianClient::Status& received) {
  const auto line = [](StatusProperty::Level level, std::string text) -> StatusLine {
    return {level, "Topic", std::move(text)};
  };
  const std::string batches =
      concat(received.batches, received.batches == 1 ? " batch" : " batches", " received",
             received.refused > 0 ? concat(", ", received.refused, " refused") : "");
  if (!received.refusal.empty()) {
    return line(StatusProperty::Error, concat(batches, ", the last because ", received.refusal));
  }
  if (received.batches == 0) {
    if (!received.other_type.empty()) {
      return line(StatusProperty::Error, concat(received.topic, " is of type ", received.other_type,
                                                ": choose one of type ", MapReceiver::mapType()));
    }
    if (received.publishers.empty()) {
      return line(StatusProperty::Warn, "Nobody publishes on " + received.topic);
    }
    if (received.unheard.empty() && received.other_user) {
      return line(StatusProperty::Warn,
                  "Another user's publisher? No batch received; shared memory delivers nothing "
                  "between users");
    }
    if (received.unheard.empty()) return line(StatusProperty::Warn, "No batch received yet");
    return line(StatusProperty::Warn, "No batch received: a publisher is " + received.unheard);
  }
  if (received.frame_id.empty()) {
    return line(
        StatusProperty::Error,
        concat(batches, ", but their header.frame_id is empty: nobody knows where the map is"));
  }
  if (received.contended) {
    return line(StatusProperty::Warn, "Publishers clear each other's map, end all but one of: " +
                                          joined(received.publishers));
  }
  if (!received.dropped_order.empty()) {
    return line(StatusProperty::Warn,
                concat(batches, "; an order is dropped: ", received.dropped_order));
  }
  return line(
      StatusProperty::Ok,
      batches + (received.joined_anew ? " by a participant of its own: see Find a fault" : ""));
}

StatusLine sceneFileStatus(const std::string& says, bool loading, bool failed,
                           const MapState& map) {
  std::string text = says;
  if (loading && map.expected > map.splats) {
    text += concat("; ", map.splats, " of ", map.expected, " splats are here");
  }
  return {failed ? StatusProperty::Error : StatusProperty::Ok, "Scene File", text};
}

StatusLine sidecarStatus(const GaussianClient::Status& received, const std::string& wanted,
                         const std::vector<DrawnViews::Report>& views) {
  for (const auto& [view, frame, camera] : views) {
    if (wanted.empty() || !isBy(frame, "sidecar (") || isBy(frame, "sidecar (" + wanted + ")")) {
      continue;
    }
    return {StatusProperty::Warn, "Sidecar",
            concat(received.sidecar.text, ", but the order is by ", frame.order_source,
                   ": the sorter's log says why")};
  }
  return {received.sidecar.failed ? StatusProperty::Warn : StatusProperty::Ok, "Sidecar",
          received.sidecar.text};
}

StatusLine noSorterStatus(const std::string& topic) {
  return {StatusProperty::Warn, "Sidecar",
          concat("No sorter publishes ", topic, "/order: start one, or set Order Source to Auto")};
}

StatusLine accuracyStatus(const std::vector<std::string>& regimes) {
  return {StatusProperty::Warn, "Accuracy", joined(regimes, "; ")};
}

StatusLine mapStatus(const MapState& map, const Backlog& backlog) {
  std::string text = concat(map.splats, " splats");
  if (map.expected > map.splats) text += concat(" of ", map.expected);
  if (map.groups > 1) text += concat(" in ", map.groups, " groups");
  text += concat(", SH degree ", map.sh_degree, ", Model ", nameOf(map.model));
  if (map.pulled) text += "; not all of it is pulled yet";
  if (map.missed > 0)
    text +=
        concat("; ", map.missed, map.missed == 1 ? " batch is missing" : " batches are missing");
  if (map.dropped > 0)
    text += concat("; ", map.dropped, map.dropped == 1 ? " splat" : " splats",
                   " with invalid values left out");
  if (backlog.edits > 0) {
    text += concat("; ", backlog.edits, backlog.edits == 1 ? " batch waits" : " batches wait",
                   " to be drawn, ", backlog.bytes >> 20, " MiB");
  }
  const bool whole = map.missed + map.dropped == 0;
  return {whole ? StatusProperty::Ok : StatusProperty::Warn, "Map", text};
}

StatusLine orderStatus(const FrameReport& frame, const std::string& view) {
  const bool sorted = frame.order_source != "unsorted";
  std::string text = concat(frame.splats, sorted ? " splats by " : " splats ", frame.order_source);
  if (frame.sort_time > 0) text += concat(" in ", frame.sort_time * 1e3, " ms");
  if (frame.order_fresh) {
    text += ", fresh";
  } else if (frame.order_age > 0) {
    text += concat(", ", frame.order_age * 1e3, " ms old");
  }
  if (frame.maps > 1) {
    const std::size_t others = frame.maps - 1;
    text += concat(", in one order with ", others, others == 1 ? " other map" : " other maps");
  }
  const bool old = !frame.order_fresh && frame.order_age > kOldOrder;
  return {old ? StatusProperty::Warn : StatusProperty::Ok, nameOf("Order", view), text};
}

StatusLine frameStatus(const FrameReport& frame, const std::string& view) {
  // The tree shows some 28 characters: first is what a user should know first.
  std::string text = frame.emulated ? "no graphics card draws: set Rasterizer to Auto; " : "";
  if (frame.paint_time == 0) text += inMs(frame.draw_time) + " by ";
  text += frame.rasterizer;
  if (frame.frame_interval > 0) text += ", every " + inMs(frame.frame_interval);
  for (const auto& [stage, time] : frame.profile) {
    text += concat(", ", stage, " ", std::setprecision(2), time * 1e3);
  }
  return {frame.emulated ? StatusProperty::Warn : StatusProperty::Ok, nameOf("Frame", view), text};
}

StatusLine pictureStatus(const FrameReport& frame, const std::string& view) {
  return {StatusProperty::Ok, nameOf("Picture", view),
          concat(inMs(frame.paint_time), ", ", inMs(frame.picture_age), " old, its camera ",
                 inMs(frame.camera_off), " off")};
}

StatusLine detailStatus(const Detail& wanted, const FrameReport& frame, std::size_t levels_bytes,
                        const std::string& view) {
  std::string text = concat(frame.splats, " of ", frame.map.splats, " splats drawn, ");
  text += frame.error > 0 ? concat("to ", frame.error, " px") : std::string("all in full");
  if (levels_bytes > 0) text += concat(", levels take ", levels_bytes >> 20, " MiB");
  if (!frame.detail_error.empty()) text += ": " + frame.detail_error;
  const bool as_wanted = frame.detail_error.empty() || wanted == Detail{};
  return {as_wanted ? StatusProperty::Ok : StatusProperty::Warn, nameOf("Detail", view), text};
}

StatusLine channelStatus(const MapState& map, const RenderSettings& settings) {
  std::vector<std::string> names;
  for (const Channel& channel : map.channels) names.push_back(channel.name);
  const auto line = [](StatusProperty::Level level, std::string text) -> StatusLine {
    return {level, "Channel", std::move(text)};
  };
  if (names.empty()) {
    return line(StatusProperty::Warn, "The map has no channel");
  }
  const ChannelColouring colouring = colouringOf(map.channels, settings);
  if (colouring.kind == kNoColours) {
    return line(StatusProperty::Warn,
                concat("The map has no channel '", settings.channel, "', it has ", joined(names)));
  }
  std::ostringstream text;
  text << names[colouring.channel];
  if (colouring.kind == kCategories) {
    text << ", categories";
  } else {
    text << ", " << colouring.least << " (blue) to " << colouring.most << " (red)";
  }
  return line(StatusProperty::Ok, text.str());
}

StatusLine memoryStatus(std::size_t gpu_bytes, std::size_t host_bytes, std::size_t shared_gpu_bytes,
                        std::size_t shared_host_bytes) {
  const auto text = [](std::size_t gpu, std::size_t host) {
    return concat("GPU ", gpu >> 20, " MiB, host ", host >> 20, " MiB");
  };
  return {StatusProperty::Ok, "Memory",
          concat(text(gpu_bytes, host_bytes), "; all maps share ",
                 text(shared_gpu_bytes, shared_host_bytes))};
}

}  // namespace rosplat
