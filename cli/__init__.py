"""Commands: parse, call, print. No mathematics, and no heavy import before a command runs.

- `app`: the program `optolever`, the one place where errors become a line and an exit code
- `commands`: the list of commands; loaded when called
- `options`: common arguments of several commands (--json, --size, scenes)
- `outputs`: output files, checked before any work
- `batch`: many captures by one command, in processes or on a cluster
- `show`: tables, progress, JSON
- `rig_devices`, `rig_capture`, `rig_targets`, `rig_live`: the devices of a rig opened; a capture by them;
  captures of targets for `calibrate`; rest and frames for `live`
- one file a command, named as it: `demo`, `live`, `doctor`, `names`; `devices`, `expose`, `sync`, `measure`,
  `record`, `replay`; `rig`, `patterns`, `capture`, `decode`, `calibrate`, `rest`, `response`, `reconstruct`,
  `form`, `export`, `report` and `window`, which is the command `show`; `sensor`, `codes`, `design`, `bench`,
  `paper`
"""

from .app import main, run

__all__ = ["main", "run"]
