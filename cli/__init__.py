"""Commands: parse, call, print. No mathematics, and no heavy import before a command runs.

- `app`: the program `optolever`, the one place where errors become a line and an exit code
- `commands`: the list of commands; loaded when called
- `arguments`: commands from functions with typed parameters; --help-all
- `options`, `names`: arguments of several commands (--json, --pixels, scenes); --list
- `outputs`: output files, checked before any work
- `batch`, `workers`: many captures by one command; processes and clusters that run them; `warm`: for them
- `show`: tables, progress, JSON
- `rig_devices`, `rig_capture`, `rig_targets`: the devices of a rig opened; a capture by them;
  captures of targets for `calibrate`; rest and frames for `live`
- `questions`: the questions about a rig, of `rig new` and `start`
- `start`: the walk from a camera to a live height; `start_steps`: its steps;
  `start_front`: who asks, on the terminal; `start_page`: on a page; `views`: pictures to aim by
- one file a command, named as it: `demo`, `doctor`, `rig`, `simulate`, `decode`, `explain`, `reconstruct`,
  `calibrate`, `report`, `live`, `design`; `camera` with `devices`, `expose`, `sync`, `record`,
  `replay`, `measure`; `form`, `export`, `sample`, `response`;
  `window` is the command `show`
"""

from .app import main, run

__all__ = ["main", "run"]
