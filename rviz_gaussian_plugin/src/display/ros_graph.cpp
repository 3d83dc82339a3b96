#include "ros_graph.hpp"

#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <system_error>

namespace rosplat {

std::string nodeOf(const rclcpp::TopicEndpointInfo& endpoint) {
  const std::string& name = endpoint.node_name();
  // How rmw_dds_common and older middleware call a node that is not known yet.
  if (name.empty() || name == "_NODE_NAME_UNKNOWN_") return {};
  const std::string& space = endpoint.node_namespace();
  return (space == "/" ? "" : space) + "/" + name;
}

bool otherUserSharesMemory(const std::string& folder, const std::string& middleware) {
  if (middleware.rfind("rmw_fastrtps", 0) != 0) return false;
  std::error_code error;
  for (const auto& file : std::filesystem::directory_iterator(folder, error)) {
    struct stat of{};
    const bool shared =
        file.path().filename().string().rfind("fast", 0) == 0;  // fastrtps_, fastdds_
    if (shared && stat(file.path().c_str(), &of) == 0 && of.st_uid != geteuid()) return true;
  }
  return false;
}

}  // namespace rosplat
