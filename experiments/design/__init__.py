"""design: what to show, what to build, and which frame to show next.

| file | holds |
|---|---|
| `ranking.py`, `candidates.py`, `user_patterns.py` | run_design; what could be shown; what users bring |
| `prediction.py`, `view.py`, `sensitivity.py` | a sequence's errors per pixel; what pixels see; to heights |
| `fringes.py`, `codes.py`, `free_codes.py` | closed forms: fringes, bits and cells, any pattern |
| `border.py`, `response.py` | closed forms: the pattern's border, nonlinear devices |
"""

from .candidates import Candidate, candidates, ladder
from .prediction import Prediction, predict
from .ranking import Design, DesignRow, run_design, simulate
from .sensitivity import Lever
from .user_patterns import user_candidate
from .view import View, view_of

__all__ = [
    "Candidate",
    "Design",
    "DesignRow",
    "Lever",
    "Prediction",
    "View",
    "candidates",
    "ladder",
    "predict",
    "run_design",
    "simulate",
    "user_candidate",
    "view_of",
]
