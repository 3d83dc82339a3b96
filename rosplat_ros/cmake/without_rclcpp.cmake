# What find_package(rosplat_ros) hears where nothing for C++ is built.
set(rosplat_ros_FOUND FALSE)
set(rosplat_ros_NOT_FOUND_MESSAGE
  "rosplat_ros was built without rclcpp (ROSPLAT_RCLCPP is OFF): it has no MapPublisher and no MapReceiver for C++")
