#!/usr/bin/env bash
# Has bloom make Debian packaging of each package, without a question: check.sh [jazzy] [noble]
# Needs bloom and rosdep. ROSDISTRO says where github.com/ros/rosdistro is; a folder works offline.
set -euo pipefail
cd "$(dirname "$0")/.."
distro=${1:-jazzy}
release=${2:-noble}
rosdistro=${ROSDISTRO:-https://raw.githubusercontent.com/ros/rosdistro/master}
case $rosdistro in /*) rosdistro=file://$rosdistro ;; esac

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export ROS_HOME=$work/ros ROSDEP_SOURCE_PATH=$work/sources ROSDISTRO_INDEX_URL=$rosdistro/index-v4.yaml
mkdir "$ROSDEP_SOURCE_PATH"
for manifest in */package.xml; do # not released yet, but by the same release
  name=$(dirname "$manifest")
  echo "$name: {ubuntu: [ros-$distro-${name//_/-}]}"
done >"$work/ours.yaml"
printf 'yaml %s\n' "file://$work/ours.yaml" "file://$PWD/packaging/rosdistro/python.yaml" \
  "$rosdistro/rosdep/base.yaml" "$rosdistro/rosdep/python.yaml" >"$ROSDEP_SOURCE_PATH/list"
mv "$ROSDEP_SOURCE_PATH/list" "$ROSDEP_SOURCE_PATH/20-default.list"
rosdep update --rosdistro "$distro" >/dev/null

for manifest in */package.xml; do
  name=$(dirname "$manifest")
  git archive HEAD "$name" | tar x -C "$work"
  (cd "$work/$name" && bloom-generate rosdebian --ros-distro "$distro" --os-name ubuntu \
    --os-version "$release" </dev/null) >"$work/log" 2>&1 || { cat "$work/log"; exit 1; }
  grep -q "^Depends:" "$work/$name/debian/control"
  echo "$name: $(head -n 1 "$work/$name/debian/changelog")"
done
