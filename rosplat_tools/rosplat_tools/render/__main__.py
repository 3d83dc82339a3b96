"""`python -m rosplat_tools.render`."""

import sys

from rosplat_tools.render import main

if __name__ == "__main__":
    sys.exit(main())
