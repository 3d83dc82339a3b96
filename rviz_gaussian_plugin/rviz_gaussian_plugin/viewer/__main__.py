"""`python -m rviz_gaussian_plugin.viewer`."""

import sys

from rosplat_ros.program.processes import run_module

if __name__ == "__main__":  # not in the processes that it starts
    sys.exit(run_module("viewer", "rviz_gaussian_plugin.viewer.command"))
