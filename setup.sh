#!/usr/bin/env bash
# Brings a machine to where the packages are built: system packages, Python environment, colcon build.
# Safe to repeat; what is already there is left alone.
# setup.sh [lab] [imu] [dev] [docs]: lab adds what rosplat_lab imports, imu QCustomPlot (GPL) for the IMU panel,
# dev both and what the tests need; docs adds what makes the documentation's site.
set -euo pipefail
trap 'exit 130' INT # what is interrupted may end as if it had failed, or not have heard of it
cd "$(dirname "$0")"
if [[ $PWD =~ [[:space:]] ]]; then
  echo "$PWD: ROS 2 builds nothing below a folder with a space in its name: move the checkout." >&2
  exit 1
fi
setting_up=1
. ./env.sh

say() { printf '\033[1m%s\033[0m\n' "$*"; }

wanted=" $* "
if [ -n "$(tr -s ' ' '\n' <<<"$wanted" | grep -vxE 'lab|imu|dev|docs|')" ]; then
  echo "setup.sh knows lab, imu, dev and docs, not:$wanted" >&2
  exit 1
fi
wants() { [[ $wanted == *" $1 "* || $wanted == *' dev '* && $1 != docs ]]; }

if [ -n "$wheels_of" ] && [ ! -f "requirements/$wheels_of.txt" ]; then
  echo "ROSPLAT_ROS asks for $ROSPLAT_ROS, and requirements/ has jazzy and kilted." >&2
  exit 1
elif [ -z "$wheels_of" ] && [ "$ROSPLAT_ROS" != "${ROS_DISTRO:-}" ]; then
  echo "ROSPLAT_ROS asks for $ROSPLAT_ROS, and ${ROS_DISTRO:-no ROS 2} is sourced." >&2
  exit 1
fi

installed() { dpkg-query -W -f '${Status}' "$1" 2>/dev/null | grep -q 'install ok installed'; }

# --- System packages ------------------------------------------------------------------------------
packages=(cmake g++ make pkg-config python3-dev python3-venv libepoxy-dev libgl1-mesa-dri libgtest-dev
  xauth xvfb)
if command -v rviz2 >/dev/null; then
  if wants imu; then packages+=(libqcustomplot-dev); fi # Ogre comes with rviz
  if wants dev; then packages+=(xdotool); fi            # the tests' mouse
  # The demo's Imu display, where ROS comes by apt.
  if installed "ros-$ROS_DISTRO-rviz2"; then packages+=("ros-$ROS_DISTRO-rviz-imu-plugin"); fi
else
  packages+=(libogre-1.12-dev)
fi
# The tests' judge of shaders, and their second OpenGL driver.
if wants dev; then packages+=(glslang-tools mesa-vulkan-drivers); fi
if wants docs; then packages+=(doxygen); fi      # reads the C++ headers
missing=()
for package in "${packages[@]}"; do
  installed "$package" || missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
  as_root=$([ "$(id -u)" = 0 ] || echo 'sudo ')
  install="apt-get install -y --no-install-recommends ${missing[*]}"
  say "These system packages are missing. To install them:"
  echo "  ${as_root}apt-get update && $as_root$install"
  if [ -t 0 ]; then
    read -rp 'Run this now? [Y/n] ' answer
    case ${answer:-y} in [yY]*) ;; *) exit 1 ;; esac
  elif [ -n "$as_root" ] && ! sudo -n true 2>/dev/null; then
    echo "Only root can: have this line run, then repeat the command." >&2
    exit 1
  fi
  ${as_root}apt-get update -qq
  ${as_root}env DEBIAN_FRONTEND=noninteractive $install -qq >/dev/null
fi

# --- Python environment ---------------------------------------------------------------------------
folder=.ros/$ROSPLAT_ROS
venv=$folder/venv
if [ -n "$moved_from" ]; then # all of it names the folder that it was made in
  say "This checkout was $moved_from: building anew"
  rm -rf "$folder"
fi
if [ ! -f "$venv/bin/activate" ]; then
  say "Creating $venv"
  system_packages=$([ -n "$wheels_of" ] || echo --system-site-packages)
  python3 -m venv $system_packages "$venv"
fi
requirements=(requirements/runtime.txt)
[ -n "$wheels_of" ] && requirements+=("requirements/$wheels_of.txt")
for part in lab dev docs; do
  if wants "$part"; then touch "$venv/$part"; fi
  [ -f "$venv/$part" ] && requirements+=("requirements/$part.txt")
done
. ./env.sh
if ! cat "${requirements[@]}" | cmp -s - "$venv/installed"; then
  say "Installing ${requirements[*]} into $venv"
  "$venv/bin/python" -m pip install -qq --disable-pip-version-check "${requirements[@]/#/--requirement=}"
  cat "${requirements[@]}" >"$venv/installed"
fi
# ROS 2 as a robot has it may lack the tools that build packages.
if ! python3 -c 'import colcon_cmake, colcon_defaults, colcon_ros' 2>/dev/null; then
  "$venv/bin/python" -m pip install -qq --disable-pip-version-check colcon-common-extensions catkin_pkg
fi
if [ -n "$wheels_of" ] && [ ! -f "$venv/exports-rewritten" ]; then
  # The wheels' CMake exports name the include folders of the machine that built them.
  read -r python_include numpy_include < <("$venv/bin/python" -c \
    'import numpy, sysconfig; print(sysconfig.get_paths()["include"], numpy.get_include())')
  grep -rlE '/opt/python/cp3' "$venv/share" --include='*.cmake' | xargs -r sed -E -i \
    -e "s#/opt/python/cp[0-9]+-cp[0-9]+/include/python[0-9.]+#$python_include#g" \
    -e "s#/opt/python/cp[0-9]+-cp[0-9]+/lib/[^;\"]*/numpy/(_core|core)/include#$numpy_include#g"
  touch "$venv/exports-rewritten"
fi

# --- Packages -------------------------------------------------------------------------------------
dev=$([ -f "$venv/dev" ] && echo ON || echo OFF)
cat >"$COLCON_DEFAULTS_FILE" <<YAML
"": {log-base: $folder/log}
build:
  build-base: $folder/build
  install-base: $folder/install
  executor: sequential
  cmake-args:
    - -DCMAKE_BUILD_TYPE=Release
    - -DPython3_EXECUTABLE=$PWD/$venv/bin/python
    - -DBUILD_TESTING=$dev
    - -DCMAKE_COMPILE_WARNING_AS_ERROR=$dev
$(printf '    - %s\n' $ROSPLAT_CMAKE_ARGS)
    - --no-warn-unused-cli
test: {build-base: $folder/build, install-base: $folder/install, executor: sequential}
test-result: {test-result-base: $folder/build}
YAML
# Nothing changed since the last build: colcon would take half a minute to find that out.
state=$( (
  cat "$COLCON_DEFAULTS_FILE" "$venv/installed"
  find . \( -name .ros -o -name __pycache__ \) -prune -o -path './r*_*/*' -type f -printf '%p %s %T@\n' | sort
) | sha256sum)
if [ -f "$folder/install/local_setup.bash" ] && [ "$state" = "$(cat "$folder/built" 2>/dev/null)" ]; then
  exit 0
fi
say "Building the packages ($folder/log/latest_build)"
rm -f "$folder/built"
# Installing deletes nothing: a module or a program that is no more would stay.
for place in "$folder"/install/*/; do
  package=$(basename "$place")
  rm -rf "$place"lib/"$package" "$place"lib/python*/site-packages/"$package"
done
log=$(mktemp)
trap 'rm -f "$log"' EXIT
# What ends, and after how long; the first time, the engine and the messages take minutes each.
if ! colcon build --event-handlers console_direct+ console_stderr- 2>&1 | tee "$log" \
  | { grep --line-buffered -E '^Finished|^Summary|^rosplat:|^-- rosplat:' || true; }; then
  grep -E 'error|Error|ERROR' -A5 "$log" | tail -n 60 >&2 || tail -n 60 "$log" >&2
  exit 1
fi
echo "$PWD" >"$folder/place"
echo "$state" >"$folder/built"
