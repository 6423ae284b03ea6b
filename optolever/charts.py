"""uPlot (MIT) for the pages: charts with axes, in one place for the report and for live."""

from pathlib import Path

__all__ = ["chart_file"]

_FOLDER = Path(__file__).with_name("uplot")


def chart_file(name: str) -> Path:
    """uplot.min.js or uplot.min.css."""
    return _FOLDER / name
