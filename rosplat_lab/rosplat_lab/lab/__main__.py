"""`python -m rosplat_lab.lab`."""

import sys

from rosplat_lab.lab import main

if __name__ == "__main__":
    sys.exit(main())
