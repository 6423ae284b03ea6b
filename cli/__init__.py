"""Commands: parse, call, print. No mathematics, and no heavy import before a command runs.

- `app`: the program `optolever`, the one place where errors become a line and an exit code
- `commands`: the list of commands; loaded when called
- `arguments`: commands from functions with typed parameters; --help-all
- `options`, `names`: arguments of several commands (--json, --pixels, scenes); --list
- `outputs`: output files, checked before any work
- `batch`, `workers`: many captures by one command; processes and clusters that run them; `warm`: for them
- `facets`: every facet of an ensemble by one command
- `printing`: tables, progress, JSON
- `rig/`: `rig new`, `start`, `camera expose`, `camera sync`; devices of a rig opened, captures by them
- one file a command, named as it: `demo`, `doctor`, `show`, `simulate`, `decode`, `explain`, `reconstruct`,
  `calibrate`, `report`, `live`, `design`; `camera` with `record`, `replay`, `measure`; `form`,
  `export`, `sample`, `response`
"""

from .app import main, run

__all__ = ["main", "run"]
