#!/usr/bin/env bash
# The C++ tests, beside them the Python tests of the packages, and those across them.
set -euo pipefail
cd "$(dirname "$0")/.."
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$((RANDOM % 100 + 1))} # not into somebody's robot
export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1} # torch's and NumPy's idle threads spin, and the others wait
rviz=$(command -v rviz2 || true)
if [ -z "$rviz" ]; then
  printf '\n\033[1;33mSKIPPED: no rviz2 here, the rviz Display was neither built nor tested.\033[0m\n\n'
fi
if ! python -c 'import ros2bag' 2>/dev/null; then
  printf '\n\033[1;33mSKIPPED: no rosbag2 here, no bag was played into rviz.\033[0m\n\n'
fi
if ! command -v splat-transform >/dev/null; then
  printf '\n\033[1;33mSKIPPED: no splat-transform here (npm install -g @playcanvas/splat-transform), scene files were '
  printf 'not held against it.\033[0m\n\n'
fi
if ! python -c 'import pxr' 2>/dev/null; then
  printf '\n\033[1;33mSKIPPED: no usd-core here (pip install usd-core), OpenUSD was neither written nor read.\033[0m\n\n'
fi
# From a folder where no package's sources hide the installed ones.
cd tests
cpp_tests() {
  local failed=0 package
  for package in rosplat_core rosplat_ros rviz_gaussian_plugin; do
    ctest --test-dir "../.ros/$ROSPLAT_ROS/build/$package" --output-on-failure -R '^test_.*' -L gtest || failed=1
  done
  return $failed
}
package_tests() { # one run for each
  local failed=0 package
  for package in "$@"; do
    python -m pytest -q --rootdir "../$package" --config-file "../$package/pytest.ini" "../$package/test" || failed=1
  done
  return $failed
}
most_packages() {
  local failed=0
  cpp_tests || failed=1
  package_tests rviz_gaussian_plugin rosplat_lab rosplat_core rosplat_ros rosplat_sorter || failed=1
  return $failed
}
cross_tests() {
  python -m pytest -q --rootdir .. --config-file ../pyproject.toml -rs . "$@"
}
# Beside each other, each in a domain of its own: most wait for programs to meet, or for one thread.
logs=$(mktemp -d)
runs=()
end_all() {
  for run in "${runs[@]}"; do kill -INT -- "-$run" 2>/dev/null || true; done
  wait
  rm -rf "$logs"
}
trap end_all EXIT
trap 'exit 130' INT TERM
beside() {
  set -m # a process group of its own; bash would have it ignore Ctrl-C else
  (
    trap 'exit 130' INT
    ROS_DOMAIN_ID=$(((ROS_DOMAIN_ID + ${#runs[@]}) % 100 + 1)) "$@"
  ) >"$logs/${#runs[@]}" 2>&1 &
  set +m
  runs+=($!)
}
beside most_packages
beside package_tests rosplat_tools # which take as long
if [ -n "$rviz" ]; then beside cross_tests -m rviz "$@"; fi
failed=0
cross_tests -m 'not rviz' "$@" || failed=1
for run in "${!runs[@]}"; do
  wait "${runs[$run]}" || failed=1
  cat "$logs/$run"
done
exit $failed
