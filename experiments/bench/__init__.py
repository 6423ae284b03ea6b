"""bench: what a sequence and a solver are worth, measured; hard cases; sweeps over many machines.

| file | holds |
|---|---|
| `cell.py` | Cell, Grid, TOML grids, keys and seeds; the grid of `optolever bench`; the record |
| `decoders.py`, `solvers.py` | frames and who decodes them; who solves |
| `run.py`, `sweeps.py` | cells to rows; Store: a result file per cell, resumed runs, here or on Dask |
| `methods.py` | every solver and integrator on the same cases |
| `report.py` | frontier and chart; the few rows that count, the page |
| `hard.py`, `hard_case.py`, `found.py` | hard cases, verdicts, figures over draws; errors against the truth |
| `hard_decode.py`, `hard_reconstruct.py`, `hard_surroundings.py` | what is hard: written lists |
| `hard_drawn.py`, `rigs.py` | what is hard: drawn rigs, scenes a little wrong, mirrors that bend |
| `hard_edges.py`, `hard_unlike.py` | scenes with depth edges, faults in them; displays unlike the sequence |
| `layered.py` | their light |
"""

from .cell import DEFAULT_GRID, Cell, Grid, Row, load_grid
from .decoders import DECODERS
from .found import Found
from .hard import hard_cases, run_hard, save_picture
from .hard_case import Case, Pooled, Result, judged, pooled
from .methods import MethodRow, run_methods
from .report import bench_markdown, bench_table, frontier, write_bench_report
from .run import absent_modules, run_cells
from .solvers import missing_peers, solver_names
from .sweeps import Store, sweep, time_cells

__all__ = [
    "DECODERS",
    "DEFAULT_GRID",
    "Case",
    "Cell",
    "Found",
    "Grid",
    "MethodRow",
    "Pooled",
    "Result",
    "Row",
    "Store",
    "absent_modules",
    "bench_markdown",
    "bench_table",
    "frontier",
    "hard_cases",
    "judged",
    "load_grid",
    "missing_peers",
    "pooled",
    "run_cells",
    "run_hard",
    "run_methods",
    "save_picture",
    "solver_names",
    "sweep",
    "time_cells",
    "write_bench_report",
]
