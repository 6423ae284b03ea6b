"""Commands: parse, call, print. No mathematics, and no heavy import before a command runs.

- `app`: the program `optolever`, the one place where errors become a line and an exit code
- `options`: arguments that several commands share (--json, --size, scenes)
- `outputs`: where commands write, checked before they work
- `show`: tables, progress bars, JSON
- one file a command: `demo`, `capture`, `decode`, `calibrate`, `reconstruct`, `paper`, `figures`, `methods`,
  `bench`, `sweep`, `hard`, `design`, `choices`, `codes`, `sensor`, `adapt`, `names`,
  `doctor`, `lab` (those for work on the program), and `window`, which is the command `show`
"""

from .app import main, run

__all__ = ["main", "run"]
