# Sourced by bash: puts ROS 2, the project's Python and its built packages on the paths.
# A sourced ROS 2 wins, then the newest in /opt/ros, then the wheels that setup.sh puts into .venv
# (at once with ROSPLAT_ROS=wheels).

root=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

source_unset_ok() { # ROS's own setup files read variables that may not be set
  local flags=$-
  set +u
  # shellcheck disable=SC1090
  . "$1"
  case $flags in *u*) set -u ;; esac
}

if [ -z "${ROS_DISTRO:-}" ] && [ "${ROSPLAT_ROS:-}" != wheels ]; then
  ros_setup=$(compgen -G '/opt/ros/*/setup.bash' | tail -n 1 || true)
  if [ -n "$ros_setup" ]; then source_unset_ok "$ros_setup"; fi
fi
export ROSPLAT_ROS=${ROSPLAT_ROS:-${ROS_DISTRO:-wheels}}

if [ -f "$root/.venv/bin/activate" ]; then source_unset_ok "$root/.venv/bin/activate"; fi
if [ "$ROSPLAT_ROS" = wheels ]; then
  export ROS_VERSION=2 ROS_DISTRO=jazzy ROS_PYTHON_VERSION=3 AMENT_PREFIX_PATH="$root/.venv"
fi
if [ -f "$root/install/local_setup.bash" ]; then source_unset_ok "$root/install/local_setup.bash"; fi
