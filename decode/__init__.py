"""Frames + Sequence -> Correspondence. (map follows)"""

from .correspondence import Correspondence, Flag, difference
from .decoder import decode
from .response import Response

__all__ = ["Correspondence", "Flag", "Response", "decode", "difference"]
