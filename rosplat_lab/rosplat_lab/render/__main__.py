"""`python -m rosplat_lab.render`."""

import sys

from rosplat_lab.render import main

if __name__ == "__main__":
    sys.exit(main())
