"""`python -m rosplat_tools.bench`."""

import sys

from rosplat_tools.bench import main

if __name__ == "__main__":
    sys.exit(main())
