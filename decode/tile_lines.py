"""What the lines of Scratch.lines hold of a tile; behind them those of the periods: a, c, s of all of them,
then their turns, variances and misfits.
"""

__all__ = [
    "AGREEMENT",
    "DOUBT",
    "DOWN",
    "FAR",
    "GAP",
    "GUESS",
    "HALF",
    "LINES",
    "MARGIN",
    "MIDDLE",
    "OF_PERIOD",
    "PLACE",
    "SPARE",
    "SPREAD",
    "STEP",
    "UP",
]

#: Lines of a period, and those before them.
OF_PERIOD, LINES = 6, 14
PLACE, SPREAD, DOUBT, GUESS, HALF, MIDDLE, FAR, UP, DOWN, GAP, AGREEMENT, STEP, MARGIN, SPARE = range(LINES)
