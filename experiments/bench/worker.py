"""Work on cells in other processes and on other machines: with optolever installed, without a checkout."""

import os
import pickle
import subprocess
import sys

from optolever.blocks import ONE_THREAD
from optolever.processes import safe_path

from .cell import Cell, Row
from .run import run_cells


def compile_apart(cells: list[Cell]) -> None:
    """Compile the cells' kernels in a separate process, so that all others load them from Numba's cache.

    A freshly compiled kernel rounds differently, in the last bits, from the same kernel out of the cache:
    otherwise the results would depend on the order of the processes.
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
        )


def group_rows(group: tuple[Cell, ...]) -> list[Row]:
    """The task of a worker: rows of cells that use the same frames, on one thread."""
    os.environ.update(ONE_THREAD)
    return list(run_cells(group, timed=False))
