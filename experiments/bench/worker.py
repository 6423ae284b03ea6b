"""Work on cells in other processes and on other machines: these have optolever installed, and no checkout."""

import os
import pickle
import subprocess
import sys

from optolever.blocks import ONE_THREAD
from optolever.processes import safe_path

from .cell import Cell, Row
from .run import run_cells


def compile_apart(cells: list[Cell]) -> None:
    """Compile what the cells use in a process of its own, so that all others load it from Numba's cache.

    Kernels that a process has just compiled round differently, in the last bits, from the same kernels out of
    the cache: without this the numbers would depend on who came first.
    """
    code = "import pickle, sys; from optolever.experiments.bench.run import warm_up; "
    code += "warm_up(pickle.load(sys.stdin.buffer), lambda *_: None)"
    with safe_path():
        subprocess.run(
            [sys.executable, "-c", code],
            input=pickle.dumps(cells),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | ONE_THREAD,
            check=False,
        )


def group_rows(group: tuple[Cell, ...]) -> list[Row]:
    """The task of a worker: rows of cells that take the same frames, on one thread."""
    os.environ.update(ONE_THREAD)
    return list(run_cells(group, timed=False))
