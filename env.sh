# Sourced by bash: puts ROS 2, the project's Python and its built packages on the paths.
# ROSPLAT_ROS names the ROS 2: an installed distribution, or wheels, which is Jazzy from PyPI, or
# kilted-wheels, Kilted from there. Unset, it is the sourced one, else the newest in /opt/ros, else
# wheels. Each has its environment and its build in a folder of its own:
# .ros/NAME/{venv,build,install,log}.

root=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

source_unset_ok() { # ROS's own setup files read variables that may not be set
  local flags=$-
  set +u
  # shellcheck disable=SC1090
  . "$1"
  case $flags in *u*) set -u ;; esac
}

if [ -z "${ROS_DISTRO:-}" ] && [[ ${ROSPLAT_ROS:-} != *wheels ]]; then
  ros_setup=$(compgen -G "/opt/ros/${ROSPLAT_ROS:-*}/setup.bash" | tail -n 1 || true)
  if [ -n "$ros_setup" ]; then source_unset_ok "$ros_setup"; fi
fi
export ROSPLAT_ROS=${ROSPLAT_ROS:-${ROS_DISTRO:-wheels}}
case $ROSPLAT_ROS in # what comes from PyPI, if it does
  wheels) wheels_of=jazzy ;;
  *-wheels) wheels_of=${ROSPLAT_ROS%-wheels} ;;
  *) wheels_of= ;;
esac

# What this ROS has nothing to build with.
ROSPLAT_CMAKE_ARGS="-DROSPLAT_RCLCPP=$([ -z "$wheels_of" ] && echo ON || echo OFF)"
ROSPLAT_CMAKE_ARGS+=" -DROSPLAT_DISPLAY=$(command -v rviz2 >/dev/null && echo ON || echo OFF)"
export ROSPLAT_CMAKE_ARGS

ros_folder=$root/.ros/$ROSPLAT_ROS
# What is built names the folder that it was built in.
moved_from=$(cat "$ros_folder/place" 2>/dev/null || true)
if [ "$moved_from" = "$root" ]; then moved_from=; fi
if [ -n "$moved_from" ] && [ -z "${setting_up:-}" ]; then
  echo "This checkout was $moved_from when it was built: ./setup.sh builds it anew." >&2
fi
export COLCON_DEFAULTS_FILE=$ros_folder/colcon.yaml # `colcon build` and `colcon test` find the folders
if [ -z "$moved_from" ] && [ -f "$ros_folder/venv/bin/activate" ]; then
  source_unset_ok "$ros_folder/venv/bin/activate"
fi
if [ -n "$wheels_of" ]; then
  export ROS_VERSION=2 ROS_DISTRO=$wheels_of ROS_PYTHON_VERSION=3 AMENT_PREFIX_PATH="$ros_folder/venv"
fi
if [ -z "$moved_from" ] && [ -f "$ros_folder/install/local_setup.bash" ]; then
  source_unset_ok "$ros_folder/install/local_setup.bash"
elif [ -z "$moved_from${setting_up:-}" ]; then
  echo "Nothing is built here for ROSPLAT_ROS=$ROSPLAT_ROS, or not all of it: ./setup.sh does that." >&2
fi
if [ -n "$wheels_of" ] && ! command -v ros2 >/dev/null; then PATH=$PATH:$root/rosplat_ros/scripts; fi
