"""The grid that `optolever bench` runs when nothing else is asked for."""

from .cell import Grid

__all__ = ["DEFAULT_GRID"]

#: Periods of 20, 22 and 25 px repeat together after 1100 px, more than any pattern of a 512 x 512 camera.
_PERIODS = "periods=20/22/25"

DEFAULT_GRID = Grid(
    scenes=("paper-simulation", "prism48", "monitor-mirror"),
    sizes=((512, 512),),
    sequences=(
        "exact",
        "gray+phase",
        "gray+phase:steps=8",
        "gray+phase:steps=3,period=16",
        "phase",
        f"phase:steps=3,{_PERIODS}",
        "phase:steps=3,periods=576/64/7",
        f"phase:steps=4,{_PERIODS}",
        f"phase:steps=4,{_PERIODS}@fringes",
        "gray",
        "gray@cv2",
        "xor-gray",
        "binary",
        "stripe:step=8",
        "lattice",
    ),
    solvers=("coupled", "paper", "paper-drops", "decoupled", "mbipy-frankot", "mbipy-dct"),
)
