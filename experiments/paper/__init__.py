"""The method of Saga, Kajimoto and Tachi, and their simulation and experiment redone.

| file | holds |
|---|---|
| `equations`, `recursion` | the paper's equations; the recursion along a line |
| `rows` | the same on every camera row of a scene |
| `study`, `line` | run_paper: simulation and experiment; the line through a dent's middle |
| `report` | its page |
"""

from .line import PaperRow
from .report import write_paper_report
from .rows import PAPER_METHODS, reconstruct_paper
from .study import PaperStudy, run_paper

__all__ = ["PAPER_METHODS", "PaperRow", "PaperStudy", "reconstruct_paper", "run_paper", "write_paper_report"]
