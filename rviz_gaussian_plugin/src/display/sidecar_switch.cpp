#include "sidecar_switch.hpp"

#include <algorithm>
#include <iterator>
#include <utility>

#include "ros_graph.hpp"
#include "rosplat_ros/ros_versions.hpp"

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

SidecarSwitch::Clients SidecarSwitch::askSorters() {
  const std::lock_guard lock(mutex_);
  if (backend_.empty()) return {};
  const auto sorters = node_->get_publishers_info_by_topic(order_topic_);
  Clients gone = forgetGone(sorters);
  for (const auto& sorter : sorters) askSorter(sorter);
  updateReport();
  return gone;
}

SidecarSwitch::Clients SidecarSwitch::forgetGone(
    const std::vector<rclcpp::TopicEndpointInfo>& sorters) {
  Clients gone;
  for (auto sidecar = sidecars_.begin(); sidecar != sidecars_.end();) {
    const bool here = std::any_of(sorters.begin(), sorters.end(), [&](const auto& sorter) {
      return sorter.endpoint_gid() == sidecar->first && nodeOf(sorter) == sidecar->second.name;
    });
    if (!here && sidecar->second.parameters) gone.push_back(std::move(sidecar->second.parameters));
    sidecar = here ? std::next(sidecar) : sidecars_.erase(sidecar);
  }
  return gone;
}

void SidecarSwitch::askSorter(const rclcpp::TopicEndpointInfo& sorter) {
  const Gid gid = sorter.endpoint_gid();
  Sidecar& sidecar = sidecars_[gid];
  const std::string name = nodeOf(sorter);
  if (name.empty()) return;
  if (!sidecar.parameters) {
    sidecar.name = name;
    sidecar.parameters =
        std::make_shared<rclcpp::AsyncParametersClient>(node_, name, parametersQos(), group_);
  }
  if (!sidecar.parameters->service_is_ready()) return;
  // During discovery a request or its answer may be lost, so it is repeated.
  const auto now = std::chrono::steady_clock::now();
  if (sidecar.asked_for == backend_ && (sidecar.answer || now - sidecar.asked_at < 3s)) return;
  sidecar.asked_for = backend_;
  sidecar.asked_at = now;
  sidecar.answer.reset();
  sidecar.parameters->set_parameters(
      {rclcpp::Parameter("backend", backend_)},
      [this, gid, name, backend = backend_](std::shared_future<Results> future) {
        const std::lock_guard lock(mutex_);
        const auto asked = sidecars_.find(gid);
        if (asked == sidecars_.end() || asked->second.asked_for != backend) return;  // too late
        Report& answer = asked->second.answer.emplace();
        const auto results = future.get();
        answer.failed = results.empty() || !results.front().successful;
        if (results.empty()) {
          answer.text = name + " has no parameter 'backend'";
        } else if (answer.failed) {
          answer.text = name + ": " + results.front().reason;
        } else {
          answer.text = name + " asked for backend " + backend;
        }
        updateReport();
      });
}

void SidecarSwitch::updateReport() {
  report_ = {};
  if (backend_.empty()) return;
  if (sidecars_.empty()) {
    report_ = {"no sidecar publishes " + order_topic_ + " that could switch to " + backend_, true};
  }
  for (const auto& [gid, sidecar] : sidecars_) {
    if (!sidecar.answer || sidecar.asked_for != backend_) continue;
    report_.text += (report_.text.empty() ? "" : "; ") + sidecar.answer->text;
    report_.failed |= sidecar.answer->failed;
  }
}

}  // namespace rosplat
