"""experiments: the demo, the paper's tables, and their reports; everything is compared with the truth.

| file | holds |
|---|---|
| `demo.py`, `metrics.py` | run_demo: the whole chain on a virtual sensor; how good it was |
| `height_report.py`, `height_view.py` | pages of demo and records; what they show of the height |
| `paper.py`, `paper_line.py`, `paper_report.py` | run_paper: the paper's simulation and experiment; page |
| `rig_report.py` | the page of a calibration |
| `figures.py` | run_figures: figures beside their limits; what checks scene.trace |
| `decode_speed.py`, `decode_errors.py` | run_decode_figures: speed, and errors beside what noise allows |
| `solver_figures.py`, `solver_bound.py` | run_solver_figures: the solver; its noise and the bound |
| `cliffs.py` | a cliff behind a mask, and the plain robust integration of it |
| `code_guide.py` | code_rows: which code when: predicted sigma and gross rate, faults tried |
| `ideal.py` | codes by their definitions: what ideal surfaces show, faults of frames and what they change |
| `place.py`, `drawn.py` | a dented mirror, its truth, its exact correspondence; dents drawn at random |
| `timing.py`, `arrays.py` | seconds of calls and stages, memory, the floor; names of types |
| `fuzz.py`, `damage.py` | fuzz: inputs damaged at random, what the program makes of them; the damage |
| `bench/`, `design/` | speed against error, hard cases, sweeps; what to show and to build |
| `page.py`, `images.py`, `report/` | HTML page; figures and maps as PNG; templates, style, viewer |
"""

from .code_guide import CODES, CodeRow, code_rows, predict_code, seen
from .decode_speed import run_decode_figures
from .demo import DemoResult, run_demo
from .figures import Figure, brute_force, run_figures
from .fuzz import FUZZED, Outcome, fuzz
from .height_report import write_demo_report, write_record_report
from .metrics import height_metrics
from .paper import PaperStudy, run_paper
from .paper_line import PaperRow
from .paper_report import write_paper_report
from .rig_report import RigStudy, judged_table, write_rig_report
from .solver_figures import run_solver_figures
from .timing import peak_bytes

__all__ = [
    "CODES",
    "FUZZED",
    "CodeRow",
    "DemoResult",
    "Figure",
    "Outcome",
    "PaperRow",
    "PaperStudy",
    "RigStudy",
    "brute_force",
    "code_rows",
    "fuzz",
    "height_metrics",
    "judged_table",
    "peak_bytes",
    "predict_code",
    "run_decode_figures",
    "run_demo",
    "run_figures",
    "run_paper",
    "run_solver_figures",
    "seen",
    "write_demo_report",
    "write_paper_report",
    "write_record_report",
    "write_rig_report",
]
