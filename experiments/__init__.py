"""experiments: the demo, the paper's tables, and their reports; everything is compared with the truth.

| file | holds |
|---|---|
| `demo.py`, `metrics.py` | run_demo: the whole chain on a virtual sensor; how good it was |
| `height_report.py`, `height_view.py` | pages of demo and records; what they show |
| `calibration.py`, `flag_words.py`, `surface_view.py` | error against sigma; flag words; the surface |
| `paper.py`, `paper_rows.py` | run_paper: the paper's simulation and experiment, and its table |
| `paper_simulation.py`, `paper_frames.py` | its measurement: exact; lattice crossings from frames |
| `paper_report.py` | the page of that |
| `rig_report.py` | the page of a calibration |
| `figures.py`, `brute_force.py` | run_figures: figures beside their limits; what checks scene.trace |
| `cliffs.py` | a cliff behind a mask, and the plain robust integration of it |
| `code_guide.py` | code_rows: which code when: predicted sigma and gross rate, faults tried |
| `faults.py` | faults of frames: swapped, shown twice, torn, lost |
| `place.py` | a dented mirror, its truth, and its exact correspondence |
| `decode_speed.py` | run_decode_figures: the decoder beside memory and other decoders |
| `speed_frames.py`, `peers.py` | frames of every code for it; others' decoders on frames of ours |
| `ideal.py` | what an ideal surface shows at a place, and frames of it |
| `decode_errors.py` | its errors beside what noise allows |
| `solver_figures.py`, `solver_bound.py` | run_solver_figures: the solver; its noise and the bound |
| `timing.py` | seconds of calls and stages, memory; Run |
| `drawn.py` | what cases drawn at random have in common |
| `fuzz.py`, `damage.py` | fuzz: inputs damaged at random, what the program makes of them; the damage |
| `bench/` | speed against error, hard cases, sweeps: a face of its own |
| `page.py`, `images.py`, `maps.py`, `report/` | HTML page, PNG, maps in mm; templates, style, viewer |
"""

from .brute_force import brute_force
from .code_guide import CODES, CodeRow, code_rows, predict_code, seen
from .decode_speed import run_decode_figures
from .demo import DemoResult, run_demo
from .figures import Figure, run_figures
from .fuzz import FUZZED, Outcome, fuzz
from .height_report import write_demo_report, write_record_report
from .metrics import height_metrics
from .paper import PaperStudy, run_paper
from .paper_report import write_paper_report
from .paper_rows import PaperRow
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
