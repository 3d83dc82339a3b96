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
# One run for each: the folders would otherwise hide the installed packages of the same name.
(cd rosplat_sorter && pytest -q test)
(cd rosplat_tools && pytest -q test)
pytest -q tests "$@"
