"""`python -m rviz_gaussian_plugin.demo`."""

import sys

from rviz_gaussian_plugin.demo import main

if __name__ == "__main__":
    sys.exit(main())
