"""`python -m rviz_gaussian_plugin.graphics_report`."""

import sys

from rviz_gaussian_plugin.graphics_report import main

if __name__ == "__main__":
    sys.exit(main())
