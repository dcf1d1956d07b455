"""``python -m stcal``."""

import sys

from stcal.cli import main

if __name__ == "__main__":
    sys.exit(main())
