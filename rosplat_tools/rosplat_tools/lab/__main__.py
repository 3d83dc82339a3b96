"""python -m rosplat_tools.lab."""

import sys

from rosplat_tools.lab import main

sys.exit(main())
