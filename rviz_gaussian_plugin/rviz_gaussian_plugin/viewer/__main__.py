"""`python -m rviz_gaussian_plugin.viewer`."""

import sys

from rviz_gaussian_plugin.viewer import main

if __name__ == "__main__":
    sys.exit(main())
