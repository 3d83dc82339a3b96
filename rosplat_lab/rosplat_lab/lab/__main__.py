"""`python -m rosplat_lab.lab`."""

import sys

from rosplat_ros.program.processes import run_module

if __name__ == "__main__":  # not in the processes that it starts
    sys.exit(run_module("lab", "rosplat_lab.lab.command"))
