#!/usr/bin/env bash
# Formats, style and types.
set -euo pipefail
cd "$(dirname "$0")/.."
ruff format --check --quiet . || { echo 'Run: ruff format .' >&2; exit 1; }
ruff check --quiet .
git ls-files '*.cpp' '*.hpp' | xargs clang-format --dry-run -Werror
# The pure parts; what touches ROS has no types to check against.
mypy --no-error-summary rosplat_sorter/rosplat_sorter rosplat_tools/rosplat_tools
echo 'lint: clean'
