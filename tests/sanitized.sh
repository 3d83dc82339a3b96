#!/usr/bin/env bash
# Builds the C++ with the compiler's sanitizers in .ros/NAME/sanitized. With the word tests, builds and runs its tests.
set -euo pipefail
cd "$(dirname "$0")/.."
sanitized=.ros/$ROSPLAT_ROS/sanitized
tests=$([ "${1:-}" = tests ] && echo ON || echo OFF)
log=$(mktemp)
trap 'rm -f "$log"' EXIT
colcon build --build-base "$sanitized/build" --install-base "$sanitized/install" \
  --base-paths rosplat_core rviz_gaussian_plugin --cmake-args -DCMAKE_BUILD_TYPE=None "-DBUILD_TESTING=$tests" \
  "-DCMAKE_CXX_FLAGS=-O1 -g1 -fno-omit-frame-pointer -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all" \
  "-Drosplat_core_DIR=$PWD/$sanitized/install/rosplat_core/share/rosplat_core/cmake" \
  -DPython3_EXECUTABLE="$(command -v python)" --no-warn-unused-cli >"$log" 2>&1 || { tail -n 60 "$log" >&2; exit 1; }
[ "$tests" = ON ] || exit 0
# Tests have memory run out, and some replace operator new to that end; what Mesa leaks isn't ours.
export ASAN_OPTIONS=allocator_may_return_null=1:alloc_dealloc_mismatch=0:detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1
for package in rosplat_core rviz_gaussian_plugin; do
  ctest --test-dir "$sanitized/build/$package" --parallel "$(nproc)" --output-on-failure -R '^test_.*' -L gtest
done
