#!/usr/bin/env bash
# Formats, style and types.
set -euo pipefail
cd "$(dirname "$0")/.."
ruff format --check --quiet . || { echo 'Run: ruff format .' >&2; exit 1; }
ruff check --quiet .
git ls-files '*.cpp' '*.hpp' '*.cu' | xargs clang-format --dry-run -Werror
# The parts that know no ROS. From the packages' own folders: from here, they would hide each other.
(cd rosplat_sorter && mypy --config-file ../pyproject.toml --no-error-summary \
  rosplat_sorter/{backends,camera.py,channels.py,depth.py,edits.py,log_text.py,map.py,map_pull.py,order_slots.py,payload.py,shared_orders.py,slot_pages.py,view.py,worker.py})
(cd rosplat_tools && mypy --config-file ../pyproject.toml --no-error-summary \
  rosplat_tools/{formats,program/{files,output,processes,progress}.py,emulation/{flight,mapping}.py,streaming/{detail,followed_view,slot_allocator,streamed_map}.py,cameras.py,convert.py,generate.py,harmonics.py,inspect_scene.py,map_changes.py,quaternions.py,round_trip.py,scenes.py,slot_map.py,slot_order.py,splats.py})
(cd rosplat_lab && MYPYPATH=../rosplat_tools mypy --config-file ../pyproject.toml --no-error-summary \
  rosplat_lab/{lab,reference,simplify,arguments.py,driven_rviz.py,machine.py,metrics.py} \
  rosplat_lab/bench/{baselines.py,charts.py,command.py,isolation.py,mouse.py,plan.py,records.py,renderers.py,rviz.py,scenes.py,sort.py})
echo 'lint: clean'
