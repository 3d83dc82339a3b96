#!/usr/bin/env bash
# test_fuzz.py with as many cases as are asked for, then once more with the C++ built with the compiler's sanitizers.
set -euo pipefail
cd "$(dirname "$0")/.."
export ROSPLAT_FUZZ_CASES=$1 ROSPLAT_FUZZ_SEED=$2 ROSPLAT_FUZZ_CASE=${3:-}
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$((RANDOM % 100 + 1))} # not into somebody's robot
export ROSPLAT_FUZZ_REPORT=$PWD/out/fuzz
rm -rf out/fuzz
mkdir -p out/fuzz
run() { (cd tests && python -m pytest -q --rootdir .. --config-file ../pyproject.toml "$@" test_fuzz.py); }

failed=0
run || failed=1
tests/sanitized.sh
export ROSPLAT_FUZZ_REPORT=
ROSPLAT_FUZZ_PRELOAD="$(g++ -print-file-name=libasan.so) $(g++ -print-file-name=libstdc++.so)"
ROSPLAT_FUZZ_PATH=$(printf '%s:' "$PWD/.ros/$ROSPLAT_ROS/sanitized/install"/*/{,local/}lib/python*/*-packages)
export ROSPLAT_FUZZ_PRELOAD ROSPLAT_FUZZ_PATH
run -k 'receivers or publisher or draws' || failed=1

python - <<'PYTHON'
import json
from pathlib import Path

for path in sorted(Path("out/fuzz").glob("*.json")):
    claims = json.loads(path.read_text())
    if not claims:
        print(f"{path.stem}: no input claimed 1 MiB of memory")
    for rank, found in claims.items():
        print(f"{path.stem}, largest {rank}: {found['claimed'] / 1e6:.1f} MB "
              f"for {found['bytes']:,} bytes (case {found['case']})")
PYTHON
[ $failed = 0 ] && echo "findings: 0 in $ROSPLAT_FUZZ_CASES cases of seed $ROSPLAT_FUZZ_SEED"
exit $failed
