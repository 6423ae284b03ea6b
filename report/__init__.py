"""report: pages of a measurement and of a calibration.

| file | holds |
|---|---|
| `height_report.py` | the page of a measurement |
| `height_tables.py`, `maps.py` | the tables, maps and charts of that page |
| `flag_table.py` | flags by area |
| `rig_report.py`, `rig_drawing.py` | the page of a calibration; a rig to scale |
| `page.py`, `page/` | HTML page, its tables and numbers; templates, style, viewer |
"""

from .height_report import write_demo_report, write_measurement_report
from .rig_report import judged_table, write_rig_report

__all__ = [
    "judged_table", "write_demo_report", "write_measurement_report", "write_rig_report",
]  # fmt: skip
