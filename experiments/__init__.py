"""experiments: demo, design, and their reports; all compared with the truth.

| file | holds |
|---|---|
| `demo.py`, `metrics.py` | run_demo: the full chain on a virtual sensor; error metrics |
| `measurement.py`, `height_report.py` | a measurement and its page |
| `height_tables.py`, `maps.py` | the tables, maps and charts of that page |
| `flag_table.py` | flags by area |
| `rig_report.py`, `rig_drawing.py` | the page of a calibration; a rig to scale |
| `user_patterns.py` | sequences, images and decoders that a user brings: function, folder, file |
| `sample.py` | sets of captures as their owners have them |
| `faults.py` | simulated frames under lag, gamma, flicker and blur of display and light |
| `timing.py`, `arrays.py` | seconds of calls and stages, memory; names of types |
| `design/` | choice of sequence and sensor |
| `page.py`, `report/` | HTML page, its tables and numbers; templates, style, viewer |
| `images.py` | figures and images as PNG |
"""

from .demo import DemoResult, compile_heights, run_demo
from .faults import Faults
from .height_report import write_demo_report, write_measurement_report
from .measurement import Measurement
from .metrics import height_metrics
from .rig_report import judged_table, write_rig_report
from .sample import SAMPLES, write_sample

__all__ = [
    "SAMPLES", "DemoResult", "Faults", "Measurement", "compile_heights", "height_metrics",
    "judged_table", "run_demo", "write_demo_report", "write_measurement_report", "write_rig_report",
    "write_sample",
]  # fmt: skip
