"""`python -m lab sync`: synchronisation and capture of drawn displays and cameras in simulated time.

$ python -m lab sync --frames 100000
Synchronisation in simulated time
setting  latency  rise   fall   shutter  within  frames  wrong  mixed  incomplete  time / bound
0        0.07     0.00   -0.02  -0.00    yes     5000    0      0      0           0.899
...
"""

from typing import Annotated

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json, Seed
from optolever.cli.printing import grid, write_json

__all__ = ["command"]

NAMES = ("latency", "rise", "fall", "shutter")


@program("sync", __doc__)
def command(
    frames: Annotated[int, Opt("--frames N", "In all.", click.IntRange(20))] = 100_000,
    seed: Seed = 0,
    json_path: Json = None,
) -> None:
    """Draw 20 displays, shutters, queues and losses; measure them; take images.

    latency, rise, fall, shutter: error in ms; within: 0.5 ms and 3 %; wrong: images of another pattern;
    mixed: with more than a level of one; time: of a frame, over latency + settling + exposure + read-out + a
    refresh + a period.
    """
    from ..hardware.synchronisation import run_sync

    figures = run_sync(frames, seed)
    rows = [
        [
            str(k),
            *(f"{1e3 * one.errors[name]:.2f}" for name in NAMES),
            "yes" if one.recovered else "no",
            *map(str, (one.frames, one.wrong, one.mixed, one.incomplete)),
            f"{one.ratio:.3f}",
        ]
        for k, one in enumerate(figures)
    ]
    heads = ("setting", *NAMES, "within", "frames", "wrong", "mixed", "incomplete", "time / bound")
    grid("Synchronisation in simulated time", heads, rows)
    counts = {name: sum(getattr(one, name) for one in figures) for name in ("frames", "wrong", "mixed")}
    write_json(json_path, {"worst_ratio": max(one.ratio for one in figures), **counts})
