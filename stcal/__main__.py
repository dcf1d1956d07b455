"""``python -m stcal``."""

from stcal.cli import run

if __name__ == "__main__":
    run()
