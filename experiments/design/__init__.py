"""design: what to show, what to build, and which frame to show next.

| file | holds |
|---|---|
| `ranking.py`, `candidates.py`, `user_patterns.py` | run_design; what could be shown; what users bring |
| `view.py`, `prediction.py` | images of a scene, whole or in windows; the decoder run on them |
| `sensitivity.py` | from errors on the pattern to errors of height, by the solver |
| `exhaustive.py`, `judged.py` | run_choices: the first choice against all candidates simulated; on what |
| `slopes.py`, `sensor_maps.py`, `sensor_sweep.py`, `sensor_report.py` | what a scene can measure |
| `goal.py` | the share of heights within a goal, fixed sequences that meet it |
| `adaptive.py`, `adaptive_study.py` | the next frames from the last; against the best fixed sequence |
"""

from .adaptive import Adapted, OnDemand, Start, Step, adapt, starting
from .adaptive_study import (
    AdaptiveRow,
    AdaptiveStudy,
    FixedSearch,
    Place,
    VirtualOnDemand,
    best_fixed,
    run_adaptive,
    study_dents,
)
from .candidates import Candidate, candidates, ladder
from .exhaustive import ChoiceRow, run_choices
from .goal import Goal, expected_share, offers, share_within
from .judged import CASES, Case, drawn_cases
from .prediction import Prediction, predict
from .ranking import Design, DesignRow, merit, run_design, simulate
from .sensitivity import Lever
from .sensor_maps import SensorMaps, sensor_maps
from .sensor_report import COLUMNS, SensorStudy, sensor_rows, write_sensor_report
from .sensor_sweep import SWEEPS, sweep_sensor, varied
from .slopes import lever_arm, rest_of, slope_limits
from .user_patterns import user_candidate
from .view import View, view_of

__all__ = [
    "CASES",
    "COLUMNS",
    "SWEEPS",
    "Adapted",
    "AdaptiveRow",
    "AdaptiveStudy",
    "Candidate",
    "Case",
    "ChoiceRow",
    "Design",
    "DesignRow",
    "FixedSearch",
    "Goal",
    "Lever",
    "OnDemand",
    "Place",
    "Prediction",
    "SensorMaps",
    "SensorStudy",
    "Start",
    "Step",
    "View",
    "VirtualOnDemand",
    "adapt",
    "best_fixed",
    "candidates",
    "drawn_cases",
    "expected_share",
    "ladder",
    "lever_arm",
    "merit",
    "offers",
    "predict",
    "rest_of",
    "run_adaptive",
    "run_choices",
    "run_design",
    "sensor_maps",
    "sensor_rows",
    "share_within",
    "simulate",
    "slope_limits",
    "starting",
    "study_dents",
    "sweep_sensor",
    "user_candidate",
    "varied",
    "view_of",
    "write_sensor_report",
]
