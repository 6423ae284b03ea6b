"""design: choice of the sequence and of the sensor.

| file | holds |
|---|---|
| `ranking.py`, `candidates.py` | run_design; candidate sequences; sequences of users |
| `comparison.py` | compare_codes: named codes, error against seconds, under faults of display and light |
| `view.py` | images of a scene, complete or in windows; the decoder run on them |
| `sensitivity.py` | error propagation from pattern coordinates to height, by the solver |
| `sensor_maps.py`, `sensor_report.py` | measuring range and sensitivity of a scene |
"""

from .candidates import Candidate, OwnCandidate, candidates, ladder, own_candidate, user_candidate
from .comparison import AXES, CodePoint, compare_codes, draw_points, save_points
from .ranking import Design, DesignRow, Simulated, code_row, frame_rate, merit, run_design, simulate
from .sensitivity import Lever
from .sensor_maps import SWEEPS, SensorMaps, sensor_maps, sweep_sensor, varied
from .sensor_report import COLUMNS, SensorStudy, sensor_rows, write_sensor_report
from .view import predict, view_of

__all__ = [
    "AXES",
    "COLUMNS",
    "SWEEPS",
    "Candidate",
    "CodePoint",
    "Design",
    "DesignRow",
    "Lever",
    "OwnCandidate",
    "SensorMaps",
    "SensorStudy",
    "Simulated",
    "candidates",
    "code_row",
    "compare_codes",
    "draw_points",
    "frame_rate",
    "ladder",
    "merit",
    "own_candidate",
    "predict",
    "run_design",
    "save_points",
    "sensor_maps",
    "sensor_rows",
    "simulate",
    "sweep_sensor",
    "user_candidate",
    "varied",
    "view_of",
    "write_sensor_report",
]
