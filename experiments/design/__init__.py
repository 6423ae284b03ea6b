"""design: what to show, what to build, and which frame to show next.

| file | holds |
|---|---|
| `ranking.py`, `candidates.py` | run_design; what could be shown; what users bring |
| `view.py` | images of a scene, whole or in windows; the decoder run on them |
| `sensitivity.py` | from errors on the pattern to errors of height, by the solver |
| `exhaustive.py` | run_choice: the first choice against all candidates simulated, on what scenes |
| `sensor_maps.py`, `sensor_report.py` | what a scene can measure |
| `adaptive.py`, `adaptive_study.py` | the next frames from the last; against the best fixed sequence |
"""

from .adaptive import Goal, adapt, share_within, starting
from .adaptive_study import AdaptiveRow, AdaptiveStudy, run_adaptive, study_dents
from .candidates import Candidate, candidates, ladder, user_candidate
from .exhaustive import CASES, Case, ChoiceRow, drawn_cases, run_choice
from .ranking import Design, DesignRow, merit, run_design, simulate
from .sensitivity import Lever
from .sensor_maps import SWEEPS, SensorMaps, sensor_maps, sweep_sensor, varied
from .sensor_report import COLUMNS, SensorStudy, sensor_rows, write_sensor_report
from .view import predict, view_of

__all__ = [
    "CASES",
    "COLUMNS",
    "SWEEPS",
    "AdaptiveRow",
    "AdaptiveStudy",
    "Candidate",
    "Case",
    "ChoiceRow",
    "Design",
    "DesignRow",
    "Goal",
    "Lever",
    "SensorMaps",
    "SensorStudy",
    "adapt",
    "candidates",
    "drawn_cases",
    "ladder",
    "merit",
    "predict",
    "run_adaptive",
    "run_choice",
    "run_design",
    "sensor_maps",
    "sensor_rows",
    "share_within",
    "simulate",
    "starting",
    "study_dents",
    "sweep_sensor",
    "user_candidate",
    "varied",
    "view_of",
    "write_sensor_report",
]
