"""design: what to show and what to build.

| file | holds |
|---|---|
| `ranking.py`, `candidates.py` | run_design; what could be shown; what users bring |
| `view.py` | images of a scene, whole or in windows; the decoder run on them |
| `sensitivity.py` | from errors on the pattern to errors of height, by the solver |
| `sensor_maps.py`, `sensor_report.py` | what a scene can measure |
"""

from .candidates import Candidate, OwnCandidate, candidates, ladder, own_candidate, user_candidate
from .ranking import Design, DesignRow, merit, run_design, simulate
from .sensitivity import Lever
from .sensor_maps import SWEEPS, SensorMaps, sensor_maps, sweep_sensor, varied
from .sensor_report import COLUMNS, SensorStudy, sensor_rows, write_sensor_report
from .view import predict, view_of

__all__ = [
    "COLUMNS",
    "SWEEPS",
    "Candidate",
    "Design",
    "DesignRow",
    "Lever",
    "OwnCandidate",
    "SensorMaps",
    "SensorStudy",
    "candidates",
    "ladder",
    "merit",
    "own_candidate",
    "predict",
    "run_design",
    "sensor_maps",
    "sensor_rows",
    "simulate",
    "sweep_sensor",
    "user_candidate",
    "varied",
    "view_of",
    "write_sensor_report",
]
