"""Commands that describe a rig and set it up, and what other commands take from them.

- `new`: `rig new`; `questions`: its questions, and those of `start`
- `start`: the walk from a camera to a live height; `start_steps`: its steps; `start_page`: who asks,
  on a page; `views`: pictures to aim by
- `expose`, `sync`: `camera expose`, `camera sync`
- `opened`: the devices of a rig opened; `recorded_capture`: a capture by them; `target_captures`: captures
  of targets for `calibrate`, of rest and frames for `live`
"""

#: Inside of cli its files are imported one by one: none of their names is public.
__all__: list[str] = []
