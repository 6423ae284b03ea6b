"""Frames + Sequence -> Correspondence."""

from .correspondence import Correspondence, Flag, difference
from .harmonics import HarmonicError, harmonic_errors
from .integrity import Finding, Integrity, check
from .response import Response

__all__ = [
    "Correspondence",
    "Finding",
    "Flag",
    "HarmonicError",
    "Integrity",
    "Response",
    "check",
    "difference",
    "harmonic_errors",
]
