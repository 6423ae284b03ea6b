"""bench: what a sequence and a solver are worth, measured; hard cases; sweeps over many machines.

| file | holds |
|---|---|
| `cell.py` | Cell, Grid, TOML grids, keys and seeds; the grid of `optolever bench` |
| `shot.py`, `decoders.py`, `solvers.py`, `decoupled.py` | mirror and frames; who decodes; who solves |
| `run.py`, `measures.py`, `row.py` | cells to rows; numbers; the record |
| `sweeps.py` | Store: one result file per cell; resumed runs, here or on Dask |
| `methods.py` | every solver and integrator on the same cases |
| `pareto.py`, `report.py` | frontier and chart; the few rows that count, the page |
| `hard.py`, `hard_case.py`, `hard_pooled.py` | hard cases, their verdicts, figures over draws |
| `hard_decode.py`, `hard_reconstruct.py`, `hard_surroundings.py` | what is hard: written lists |
| `hard_drawn.py`, `rigs.py` | what is hard: drawn, up to the height; rigs |
| `hard_curved.py`, `hard_scene.py` | mirrors that bend inside of a pixel; scenes that are a little wrong |
| `hard_edges.py`, `hard_unlike.py` | scenes with depth edges, faults in them; displays unlike the sequence |
| `layered.py`, `plain_decoder.py` | their light; codes by definition |
| `surroundings.py`, `found.py` | what is around a mirror; errors against the truth |
"""

from .cell import DEFAULT_GRID, Cell, Grid, load_grid
from .decoders import DECODERS
from .found import Found
from .hard import hard_cases, run_hard, save_picture
from .hard_case import Case, Result, judged
from .hard_pooled import Pooled, pooled
from .methods import MethodRow, missing_peers, run_methods
from .pareto import frontier
from .report import bench_markdown, bench_table, write_bench_report
from .row import Row
from .run import absent_modules, run_cells
from .solvers import solver_names
from .sweeps import Cluster, Store, sweep, time_cells, warm_up_from_json

__all__ = [
    "DECODERS",
    "DEFAULT_GRID",
    "Case",
    "Cell",
    "Cluster",
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
    "warm_up_from_json",
    "write_bench_report",
]
