"""`python -m rosplat_tools.lab`."""

import sys

from rosplat_tools.lab import main

if __name__ == "__main__":
    sys.exit(main())
