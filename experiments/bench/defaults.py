"""The grid that `optolever bench` runs when nothing else is asked for."""

from .cell import Grid

__all__ = ["DEFAULT_GRID"]

#: Periods of 20, 22 and 25 px repeat together after 1100 px, more than any pattern of a 512 x 512 camera.
_PERIODS = "periods=20/22/25"
#: Of the kind that `optolever design` prefers: three periods of n, n - 1 and n - sqrt(n) fringes, here on
#: up to 1122 px (n = 1122 / 8).
_DESIGNED = "phase:steps=3,periods=8.73782/8.05745/8"

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
        _DESIGNED,
        f"{_DESIGNED}@fringes",
        f"phase:steps=4,{_PERIODS}",
        "gray",
        "gray@cv2",
        "xor-gray",
        "binary",
        "stripe:step=8",
        "crossed:period=10",
        "lattice",
    ),
    solvers=("coupled", "paper", "paper-drops", "decoupled", "mbipy-frankot", "mbipy-dct"),
)
