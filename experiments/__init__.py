"""experiments: the demo, the paper's tables, and their reports; everything is compared with the truth.

| file | holds |
|---|---|
| `demo.py`, `metrics.py` | run_demo: the whole chain on a virtual sensor; how good it was |
| `demo_report.py`, `demo_pictures.py`, `demo_inputs.py` | the demo's page: result; flags, maps, frames |
| `calibration.py`, `flag_words.py`, `surface_view.py` | error against sigma; flag words; the surface |
| `page.py`, `images.py`, `maps.py`, `report/` | HTML page, PNG, maps in mm; templates, style, viewer |
"""

from .demo import DemoResult, run_demo
from .demo_report import demo_html, write_demo_report
from .metrics import height_metrics, peak_bytes

__all__ = [
    "DemoResult",
    "demo_html",
    "height_metrics",
    "peak_bytes",
    "run_demo",
    "write_demo_report",
]
