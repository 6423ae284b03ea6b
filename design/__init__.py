"""design: choice of the sequence and of the sensor.

| file | holds |
|---|---|
| `ranking.py`, `candidates.py` | run_design; candidate sequences; sequences of users |
| `tradeoff.py` | compare_codes: error against CPU seconds and seconds of acquisition |
| `chart.py` | its chart |
| `view.py` | images of a scene, complete or in windows; the decoder run on them |
| `sensitivity.py` | error propagation from pattern coordinates to height, by the solver |
| `measuring_range.py` | measuring range and sensitivity of a scene |
"""

from .candidates import Candidate, candidates, in_colour, ladder, user_candidate
from .chart import Panel, condition_panels, write_tradeoff_chart
from .measuring_range import SensorMaps, sensor_maps
from .ranking import Design, merit, run_design
from .sensitivity import Lever, Simulation
from .tradeoff import LEAST_SHARE, Tradeoff, compare_codes, frame_rate, row_of, simulated, write_tradeoff_csv
from .view import predict, view_of

__all__ = [
    "LEAST_SHARE", "Candidate", "Design", "Lever", "Panel", "SensorMaps", "Simulation", "Tradeoff",
    "candidates", "compare_codes", "condition_panels", "frame_rate", "in_colour", "ladder", "merit",
    "predict", "row_of", "run_design", "sensor_maps", "simulated", "user_candidate", "view_of",
    "write_tradeoff_chart", "write_tradeoff_csv",
]  # fmt: skip
