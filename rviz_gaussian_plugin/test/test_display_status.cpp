#include <gtest/gtest.h>

#include "../src/display/display_status.hpp"

namespace rosplat {

namespace {

using rviz_common::properties::StatusProperty;

GaussianClient::Status heard(std::uint64_t batches) {
  GaussianClient::Status received;
  received.topic = "/robot/map";
  received.publishers = {"slam", "player"};
  received.batches = batches;
  received.frame_id = "map";
  return received;
}

DrawnViews::Report sortedBy(const std::string& source) {
  FrameReport frame;
  frame.splats = 7;
  frame.order_source = source;
  return {"", frame, {}};
}

bool has(const StatusLine& line, const std::string& words) {
  return line.text.find(words) != std::string::npos;
}

}  // namespace

TEST(ChannelStatus, saysWhichIsDrawnAndHow) {
  MapState map;
  RenderSettings settings;
  EXPECT_EQ(channelStatus(map, settings).level, StatusProperty::Warn);
  map.channels = joined({}, {"label", "seen"});
  map.channels[0].widen(3);
  for (const float value : {0.5f, kNoValue, 0.25f}) map.channels[1].widen(value);
  EXPECT_EQ(channelStatus(map, settings).text, "label, categories");
  settings.channel = "seen";
  EXPECT_EQ(channelStatus(map, settings).text, "seen, 0.25 (blue) to 0.5 (red)");
  settings.channel_range = {0, 1};
  EXPECT_EQ(channelStatus(map, settings).text, "seen, 0 (blue) to 1 (red)");
  settings.channel = "age";
  EXPECT_EQ(channelStatus(map, settings).text, "The map has no channel 'age', it has label, seen");
  EXPECT_EQ(channelStatus(map, settings).level, StatusProperty::Warn);
}

TEST(TopicStatus, saysWhyNothingArrives) {
  GaussianClient::Status received = heard(0);
  received.publishers.clear();
  EXPECT_EQ(topicStatus(received).text, "Nobody publishes on /robot/map");
  received = heard(0);
  EXPECT_TRUE(has(topicStatus(received), "No batch received yet"));
  received.unheard = "best effort";
  EXPECT_TRUE(has(topicStatus(received), "a publisher is best effort"));
  EXPECT_EQ(topicStatus(received).level, StatusProperty::Warn);
  received.other_type = "std_msgs/msg/String";
  EXPECT_TRUE(has(topicStatus(received), "/robot/map is of type std_msgs/msg/String"));
  EXPECT_EQ(topicStatus(received).level, StatusProperty::Error);
}

TEST(TopicStatus, saysTheWorstFirst) {
  GaussianClient::Status received = heard(3);
  received.other_type = "std_msgs/msg/String";  // of another that nobody needs
  EXPECT_EQ(topicStatus(received).level, StatusProperty::Ok);
  received.contended = true;
  EXPECT_TRUE(has(topicStatus(received), "end all but one of: slam, player"));
  EXPECT_EQ(topicStatus(received).level, StatusProperty::Warn);
  received.refused = 2;
  received.refusal = "it ends early";
  EXPECT_TRUE(
      has(topicStatus(received), "3 batches received, 2 refused, the last because it ends early"));
  EXPECT_EQ(topicStatus(received).level, StatusProperty::Error);
  received.contended = false;
  received.refusal.clear();  // a good one followed
  EXPECT_EQ(topicStatus(received).text, "3 batches received, 2 refused");
  EXPECT_EQ(topicStatus(received).level, StatusProperty::Ok);
}

TEST(TopicStatus, saysWhyAMapWithoutAFrameIsNotDrawn) {
  GaussianClient::Status received = heard(3);
  received.frame_id.clear();
  EXPECT_TRUE(has(topicStatus(received), "header.frame_id is empty"));
  EXPECT_EQ(topicStatus(received).level, StatusProperty::Error);
}

TEST(TopicStatus, guessesThatAnotherUsersPublisherIsNotHeard) {
  GaussianClient::Status received = heard(0);
  received.other_user = true;
  EXPECT_TRUE(has(topicStatus(received), "Another user's publisher?"));
  received.unheard = "best effort";  // which is known
  EXPECT_FALSE(has(topicStatus(received), "user"));
  received = heard(0);
  received.other_user = true;
  received.publishers.clear();
  EXPECT_FALSE(has(topicStatus(received), "user"));
}

TEST(SidecarStatus, warnsWhereNobodySorts) {
  EXPECT_EQ(noSorterStatus("/robot/map").level, StatusProperty::Warn);
  EXPECT_TRUE(has(noSorterStatus("/robot/map"), "No sorter publishes /robot/map/order"));
}

TEST(SidecarStatus, warnsOfAnotherBackendThanTheOneAskedFor) {
  GaussianClient::Status received;
  received.sidecar.text = "/sorter asked for backend torch";
  EXPECT_EQ(sidecarStatus(received, "torch", {sortedBy("sidecar (torch)")}).level,
            StatusProperty::Ok);
  EXPECT_EQ(sidecarStatus(received, "torch", {sortedBy("gpu")}).level, StatusProperty::Ok);
  EXPECT_EQ(sidecarStatus(received, "", {sortedBy("sidecar (native)")}).level, StatusProperty::Ok);
  const StatusLine line =
      sidecarStatus(received, "torch", {sortedBy("sidecar (torch)"), sortedBy("sidecar (native)")});
  EXPECT_EQ(line.level, StatusProperty::Warn);
  EXPECT_TRUE(has(line, "the order is by sidecar (native)"));
  received.sidecar.failed = true;
  EXPECT_EQ(sidecarStatus(received, "", {}).level, StatusProperty::Warn);
}

TEST(MapStatus, warnsOfWhatIsMissingNotOfWhatIsStillToCome) {
  MapState map;
  map.splats = 10;
  map.expected = 20;
  EXPECT_TRUE(has(mapStatus(map, {}), "10 splats of 20"));
  EXPECT_EQ(mapStatus(map, {}).level, StatusProperty::Ok);
  map.missed = 1;
  EXPECT_EQ(mapStatus(map, {}).level, StatusProperty::Warn);
  map.missed = 0;
  map.dropped = 1;
  EXPECT_EQ(mapStatus(map, {}).level, StatusProperty::Warn);
}

TEST(TopicStatus, tellsWhyAnOrderIsDropped) {
  GaussianClient::Status received;
  received.batches = 1;
  received.frame_id = "map";
  EXPECT_EQ(topicStatus(received).level, StatusProperty::Ok);
  received.dropped_order = "it has 9 slots, the map 3";
  EXPECT_EQ(topicStatus(received).level, StatusProperty::Warn);
  EXPECT_TRUE(has(topicStatus(received), received.dropped_order));
}

TEST(MapStatus, tellsWhatWaitsToBeDrawn) {
  EXPECT_FALSE(has(mapStatus({}, {}), "wait"));
  EXPECT_TRUE(has(mapStatus({}, {7, 12u << 20}), "7 batches wait to be drawn, 12 MiB"));
}

TEST(OrderStatus, isToldForEachView) {
  FrameReport frame = sortedBy("gpu").frame;
  frame.order_fresh = true;
  EXPECT_EQ(orderStatus(frame, "").name, "Order");
  EXPECT_EQ(orderStatus(frame, "").text, "7 splats by gpu, fresh");
  frame.order_fresh = false;
  frame.order_age = 0.25;
  frame.sort_time = 0.004;
  EXPECT_EQ(orderStatus(frame, "view 2").name, "Order (view 2)");
  EXPECT_EQ(orderStatus(frame, "view 2").text, "7 splats by gpu in 4.0 ms, 250.0 ms old");
  EXPECT_EQ(orderStatus(frame, "").level, StatusProperty::Ok);
  frame.order_age = 5;
  EXPECT_EQ(orderStatus(frame, "").level, StatusProperty::Warn);
  frame.order_fresh = true;
  EXPECT_EQ(orderStatus(frame, "").level, StatusProperty::Ok);
}

TEST(FrameStatus, isShort) {
  FrameReport frame;
  frame.rasterizer = "tiles";
  frame.draw_time = 0.00213;
  EXPECT_EQ(frameStatus(frame, "").text, "2.1 ms by tiles");
  frame.frame_interval = 0.0167;
  EXPECT_EQ(frameStatus(frame, "").text, "2.1 ms by tiles, every 17 ms");
  frame.profile["sort"] = 0.001;
  EXPECT_EQ(frameStatus(frame, "").text, "2.1 ms by tiles, every 17 ms, sort 1.00");
  frame = {};
  frame.rasterizer = "processor";
  frame.paint_time = 2.4434, frame.draw_time = 0.0687, frame.frame_interval = 0.4301;
  frame.picture_age = 2.9113, frame.camera_off = 2.4959;
  EXPECT_EQ(frameStatus(frame, "view 2").text, "processor, every 430 ms");
  EXPECT_EQ(frameStatus(frame, "view 2").name, "Frame (view 2)");
  EXPECT_EQ(frameStatus(frame, "").level, StatusProperty::Ok);
  EXPECT_EQ(pictureStatus(frame, "").text, "2443 ms, 2911 ms old, its camera 2496 ms off");
}

TEST(FrameStatus, warnsOfTilesWithoutACard) {
  FrameReport frame;
  frame.rasterizer = "tiles";
  EXPECT_EQ(frameStatus(frame, "").level, StatusProperty::Ok);
  frame.emulated = true;
  EXPECT_EQ(frameStatus(frame, "").level, StatusProperty::Warn);
  EXPECT_TRUE(has(frameStatus(frame, ""), "no graphics card draws: set Rasterizer to Auto"));
}

TEST(DetailStatus, saysWhatWasDrawnAndWarnsWhereThatIsAllAgainstTheWish) {
  FrameReport frame;
  frame.splats = 300;
  frame.map.splats = 1000;
  frame.error = 1.5;
  const Detail wanted{Detail::Kind::kSplats, 300};
  EXPECT_TRUE(has(detailStatus(wanted, frame, 5 << 20, ""), "300 of 1000 splats drawn, to 1.5 px"));
  EXPECT_TRUE(has(detailStatus(wanted, frame, 5 << 20, ""), "levels take 5 MiB"));
  EXPECT_EQ(detailStatus(wanted, frame, 0, "").level, StatusProperty::Ok);
  frame.error = 0;
  frame.detail_error = "a graphics card draws all";
  EXPECT_TRUE(has(detailStatus(wanted, frame, 0, ""), "all in full: a graphics card draws all"));
  EXPECT_EQ(detailStatus(wanted, frame, 0, "").level, StatusProperty::Warn);
}

TEST(AccuracyStatus, warnsOfAllRegimesInALine) {
  EXPECT_EQ(accuracyStatus({"far", "wide"}).text, "far; wide");
  EXPECT_EQ(accuracyStatus({"far"}).level, StatusProperty::Warn);
}

}  // namespace rosplat
