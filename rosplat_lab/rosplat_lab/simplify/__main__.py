"""`python -m rosplat_lab.simplify`."""

import sys

from rosplat_lab.simplify import main

if __name__ == "__main__":
    sys.exit(main())
