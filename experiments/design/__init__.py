"""design: what to show, what to build, and which frame to show next.

| file | holds |
|---|---|
| `ranking.py`, `candidates.py`, `user_patterns.py` | run_design; what could be shown; what users bring |
| `prediction.py`, `records.py` | a sequence's errors per pixel |
| `view.py`, `sensitivity.py` | what pixels see; from coordinates to heights |
| `fringe_axis.py` | fringes along an axis, from the closed forms below |
| `fringes.py`, `codes.py`, `free_codes.py` | closed forms: fringes, bits and cells, any pattern |
| `image_reading.py` | swept stripes and bare codes, as the decoder reads images of them |
| `cells.py`, `undoing.py` | the stairs of the display's cells; what the decoder leaves of them |
| `steep.py`, `gathering.py` | what a sharp display's stairs leave that have no inverse; who can tell them |
| `survey.py` | whether the blur is told, by contrasts or their swing, and how well |
| `exhaustive.py`, `judged.py` | run_choices: the first choice against all candidates simulated; on what |
| `slopes.py`, `sensor_maps.py`, `sensor_sweep.py`, `sensor_report.py` | what a scene can measure |
| `adaptive.py`, `on_demand.py` | the next frames from the last |
| `adaptive_study.py`, `fixed_search.py`, `outlook.py` | against the best fixed sequence; its prediction |
| `border.py`, `shadow.py`, `response.py` | closed forms: the border, its shadow, nonlinear devices |
| `border_draws.py` | pixels beside the border that are refused in some draws of noise: what the others tell |
"""

from .adaptive import Adapted, Goal, Start, Step, adapt, share_within, starting
from .adaptive_study import (
    AdaptiveRow,
    AdaptiveStudy,
    FixedSearch,
    Place,
    best_fixed,
    run_adaptive,
    study_dents,
)
from .candidates import Candidate, candidates, ladder
from .exhaustive import ChoiceRow, run_choices
from .fixed_search import offers
from .judged import CASES, Case, drawn_cases
from .on_demand import OnDemand, VirtualOnDemand
from .outlook import Outlook
from .prediction import Prediction, predict
from .ranking import Design, DesignRow, merit, run_design, simulate
from .sensitivity import Lever
from .sensor_maps import SensorMaps, sensor_maps
from .sensor_report import COLUMNS, SensorStudy, sensor_html, sensor_rows, write_sensor_report
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
    "Outlook",
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
    "ladder",
    "lever_arm",
    "merit",
    "offers",
    "predict",
    "rest_of",
    "run_adaptive",
    "run_choices",
    "run_design",
    "sensor_html",
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
