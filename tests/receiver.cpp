// A receiver of a map that a test asks: "busy 1" or "busy 0" on stdin, or "state" and slots.
// Answers with the map's id, its revision, batches missed, whether a pull is under way, and which
// of the slots are in use. With the argument "whole" it ends once the map is complete.

#include <atomic>
#include <chrono>
#include <iostream>
#include <mutex>
#include <rosplat_core/map/gaussian_map.hpp>
#include <rosplat_ros/batches.hpp>
#include <rosplat_ros/map_receiver.hpp>
#include <sstream>
#include <thread>

int main(int argc, char** argv) {
  rclcpp::init(argc, argv);
  const auto node = std::make_shared<rclcpp::Node>("receiver");
  std::atomic<bool> busy = false;
  std::mutex mutex;
  rosplat::GaussianMap map;
  rosplat::ReceiverOptions options;
  options.busy = [&busy] { return busy.load(); };
  const auto apply = [&](const auto& message, rosplat::Arrival arrival) {
    const std::lock_guard lock(mutex);
    rosplat::BatchReport report;
    map.apply(rosplat::toBatch(message, arrival), report);
  };
  const rosplat::MapReceiver receiver(*node, apply, options);
  std::thread spinning([&node] { rclcpp::spin(node); });
  const auto complete = [&] {
    const std::lock_guard lock(mutex);
    return map.state().complete();
  };
  if (argc > 1 && std::string(argv[1]) == "whole") {
    while (!complete()) std::this_thread::sleep_for(std::chrono::milliseconds(50));
    rclcpp::shutdown();
  }
  for (std::string line, command; rclcpp::ok() && std::getline(std::cin, line);) {
    std::istringstream words(line);
    words >> command;
    if (command == "busy") {
      bool value = false;
      words >> value;
      busy = value;
      continue;
    }
    const std::lock_guard lock(mutex);
    const rosplat::MapState& state = map.state();
    std::cout << (state.id.empty() ? "none" : state.id) << ' ' << state.revision << ' '
              << state.missed << ' ' << state.pulled;
    for (std::uint32_t slot = 0; words >> slot;) std::cout << ' ' << map.inUse(slot);
    std::cout << std::endl;
  }
  rclcpp::shutdown();
  spinning.join();
}
