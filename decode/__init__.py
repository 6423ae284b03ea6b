"""Frames + Sequence -> Correspondence."""

from .correspondence import Correspondence, Flag, difference
from .decoder import decode
from .harmonics import HarmonicError, harmonic_errors
from .response import Response

__all__ = ["Correspondence", "Flag", "HarmonicError", "Response", "decode", "difference", "harmonic_errors"]
