"""`python -m rosplat_tools.viewer`."""

import sys

from rosplat_tools.viewer import main

if __name__ == "__main__":
    sys.exit(main())
