#!/usr/bin/env bash
# C++ tests, then the Python tests of the packages and across them.
set -euo pipefail
cd "$(dirname "$0")/.."
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$((RANDOM % 100 + 1))} # not into somebody's robot
for package in rosplat_sorter rviz_gaussian_plugin; do
  ctest --test-dir "build/$package" --output-on-failure -R '^test_.*' -L gtest
done
if ! command -v rviz2 >/dev/null; then
  printf '\n\033[1;33mSKIPPED: no rviz2 here, the rviz Display was neither built nor tested.\033[0m\n\n'
fi
if ! python -c 'import ros2bag' 2>/dev/null; then
  printf '\n\033[1;33mSKIPPED: no rosbag2 here, no bag was played into rviz.\033[0m\n\n'
fi
if ! command -v splat-transform >/dev/null; then
  printf '\n\033[1;33mSKIPPED: no splat-transform here (npm install -g @playcanvas/splat-transform), scene files were '
  printf 'not held against it.\033[0m\n\n'
fi
# One run for each, from a folder where no package's sources hide the installed ones.
cd tests
failed=0
package_tests() {
  local failed=0
  for package in "$@"; do
    python -m pytest -q --rootdir "../$package" --config-file "../$package/pytest.ini" "../$package/test" || failed=1
  done
  return $failed
}
# Those that mostly wait for programs to meet run beside those that mostly draw, in a domain of their own.
log=$(mktemp)
trap 'rm -f "$log"' EXIT
ROS_DOMAIN_ID=$((ROS_DOMAIN_ID % 100 + 1)) package_tests rosplat_sorter rosplat_tools >"$log" 2>&1 &
beside=$!
package_tests rviz_gaussian_plugin rosplat_lab || failed=1
python -m pytest -q --rootdir .. --config-file ../pyproject.toml -rs . "$@" || failed=1
wait $beside || failed=1
cat "$log"
exit $failed
