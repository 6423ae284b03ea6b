"""`python -m lab NAME ...`, from the root of the checkout."""

import sys

from .program import run

sys.exit(run())
