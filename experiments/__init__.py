"""experiments: demo, design, and their reports; all compared with the truth.

| file | holds |
|---|---|
| `demo.py`, `metrics.py` | run_demo: the full chain on a virtual sensor; error metrics |
| `measurement.py`, `height_report.py` | a measurement and its page |
| `height_tables.py`, `maps.py` | the tables, maps and charts of that page |
| `figures.py`, `flag_table.py` | numbers on a page and in its file; flags by area |
| `rig_report.py`, `rig_drawing.py` | the page of a calibration; a rig to scale |
| `sync_report.py` | the page of a synchronisation |
| `code_guide.py` | code_rows: comparison of codes: predicted sigma and gross rate, detection of faults |
| `ideal.py` | codes by their definitions: ideal levels, faults of frames |
| `place.py` | a dented mirror, its truth, its exact correspondence |
| `acquisition_check.py` | images that show the preceding pattern instead of their nominal one |
| `own_sequence.py`, `own_function.py` | sequences that a user brings: function, folder, file |
| `own_images.py` | patterns along both axes that a user brings, and the user's decoder |
| `faults.py` | lag, gamma, flicker and blur of display and light |
| `timing.py`, `arrays.py` | seconds of calls and stages, memory, the floor; names of types |
| `design/` | choice of sequence and sensor |
| `page.py`, `images.py`, `report/` | HTML page; figures and maps as PNG; templates, style, viewer |
"""

from .acquisition_check import frames_of_another
from .code_guide import CODES, CodeRow, code_rows, code_that_decodes, predict_code, seen
from .demo import DemoResult, run_demo
from .faults import Faults
from .height_report import write_demo_report, write_measurement_report
from .measurement import Measurement
from .metrics import height_metrics, mirror_coverage
from .rig_report import RigStudy, judged_table, write_rig_report
from .sync_report import write_sync_report
from .timing import peak_bytes

__all__ = [
    "CODES",
    "CodeRow",
    "DemoResult",
    "Faults",
    "Measurement",
    "RigStudy",
    "code_rows",
    "code_that_decodes",
    "frames_of_another",
    "height_metrics",
    "judged_table",
    "mirror_coverage",
    "peak_bytes",
    "predict_code",
    "run_demo",
    "seen",
    "write_demo_report",
    "write_measurement_report",
    "write_rig_report",
    "write_sync_report",
]
