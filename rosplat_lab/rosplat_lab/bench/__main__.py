"""`python -m rosplat_lab.bench`."""

import sys

from rosplat_lab.bench import main

if __name__ == "__main__":
    sys.exit(main())
