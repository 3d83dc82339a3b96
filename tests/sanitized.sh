#!/usr/bin/env bash
# Builds the C++ with the compiler's sanitizers in .ros/NAME/sanitized. With the word tests, builds and runs its tests.
set -euo pipefail
cd "$(dirname "$0")/.."
sanitized=.ros/$ROSPLAT_ROS/sanitized
tests=$([ "${1:-}" = tests ] && echo ON || echo OFF)
log=$(mktemp)
trap 'rm -f "$log"' EXIT
colcon build --build-base "$sanitized/build" --install-base "$sanitized/install" \
  --base-paths rosplat_core rviz_gaussian_plugin --cmake-args $ROSPLAT_CMAKE_ARGS -DCMAKE_BUILD_TYPE=None "-DBUILD_TESTING=$tests" \
  "-DCMAKE_CXX_FLAGS=-O1 -g1 -fno-omit-frame-pointer -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all" \
  "-Drosplat_core_DIR=$PWD/$sanitized/install/rosplat_core/share/rosplat_core/cmake" \
  -DPython3_EXECUTABLE="$(command -v python)" --no-warn-unused-cli >"$log" 2>&1 || { tail -n 60 "$log" >&2; exit 1; }
[ "$tests" = ON ] || exit 0
# Some tests replace operator new, and what Mesa leaks isn't ours. ASan's operator new ends the program where a test has
# memory run out.
export ASAN_OPTIONS=alloc_dealloc_mismatch=0:detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1
export GTEST_FILTER=-CpuRasterizer.says_so_where_there_is_no_memory
failed=0
for test in "$sanitized"/build/{rosplat_core,rviz_gaussian_plugin}/test_*; do
  if [ -f "$test" ] && [ -x "$test" ]; then "$test" --gtest_brief=1 || failed=1; fi
done
exit $failed
