"""bench: measured accuracy and time of sequences and solvers.

| file | holds |
|---|---|
| `cell.py` | Cell, Grid, TOML grids, keys and seeds; the grid of `optolever bench`; the record |
| `decoders.py`, `solvers.py` | frames and their decoders; solvers |
| `run.py`, `measures.py` | cells to rows; the metrics of a row |
| `store.py`, `worker.py` | Store: a result file per cell; cells on other machines |
| `report.py` | Pareto frontier and chart; the best rows by category, the page |
"""

from .cell import DEFAULT_GRID, Cell, Grid, Row, load_grid
from .decoders import DECODERS
from .report import bench_markdown, bench_table, frontier, write_bench_report
from .run import absent_modules, run_cells
from .solvers import missing_peers, solver_names
from .store import Store, time_cells

__all__ = [
    "DECODERS",
    "DEFAULT_GRID",
    "Cell",
    "Grid",
    "Row",
    "Store",
    "absent_modules",
    "bench_markdown",
    "bench_table",
    "frontier",
    "load_grid",
    "missing_peers",
    "run_cells",
    "solver_names",
    "time_cells",
    "write_bench_report",
]
