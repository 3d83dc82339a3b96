#include "sidecar_switch.hpp"

#include <utility>
#include <vector>

#include "ros_graph.hpp"
#include "ros_versions.hpp"

namespace rosplat {

namespace {
using namespace std::chrono_literals;
using Results = std::vector<rcl_interfaces::msg::SetParametersResult>;
}  // namespace

SidecarSwitch::SidecarSwitch(rclcpp::Node::SharedPtr node, std::string order_topic,
                             rclcpp::CallbackGroup::SharedPtr group)
    : node_(std::move(node)), order_topic_(std::move(order_topic)), group_(std::move(group)) {}

void SidecarSwitch::ask(const std::string& backend) {
  const std::lock_guard lock(mutex_);
  backend_ = backend;
  if (backend_.empty()) report_ = {};
}

SidecarSwitch::Report SidecarSwitch::report() const {
  const std::lock_guard lock(mutex_);
  return report_;
}

void SidecarSwitch::tell() {
  std::string backend;
  {
    const std::lock_guard lock(mutex_);
    backend = backend_;
  }
  if (backend.empty()) return;
  const auto sorters = node_->get_publishers_info_by_topic(order_topic_);
  if (sorters.empty()) {
    parameters_.reset();
    note(backend, "no sidecar publishes " + order_topic_ + " that could switch to " + backend,
         true);
    return;
  }
  const auto& sorter = sorters.front();
  const std::string name = nodeOf(sorter);
  if (name.empty()) return;
  if (!parameters_ || sidecar_ != name || publisher_ != sorter.endpoint_gid()) {
    sidecar_ = name;
    publisher_ = sorter.endpoint_gid();
    told_.clear();
    parameters_ =
        std::make_shared<rclcpp::AsyncParametersClient>(node_, sidecar_, parametersQos(), group_);
  }
  if (!parameters_->service_is_ready()) return;
  // While the two get to know each other, question or answer may be lost.
  const auto now = std::chrono::steady_clock::now();
  if (told_ == backend && (answered_ || now - told_at_ < 3s)) return;
  told_ = backend;
  told_at_ = now;
  answered_ = false;
  parameters_->set_parameters(
      {rclcpp::Parameter("backend", backend)},
      [this, name = sidecar_, backend](std::shared_future<Results> future) {
        answered_ = true;
        const auto results = future.get();
        if (results.empty()) return note(backend, name + " knows no backends", true);
        const auto& result = results.front();
        note(backend, result.successful ? name + " asked for backend " + backend : result.reason,
             !result.successful);
      });
}

void SidecarSwitch::note(const std::string& backend, const std::string& text, bool failed) {
  const std::lock_guard lock(mutex_);
  if (backend == backend_) report_ = {text, failed};  // else another one is asked for since
}

}  // namespace rosplat
