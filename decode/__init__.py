"""Frames + Sequence -> Correspondence. (map follows)"""

from .correspondence import Correspondence, Flag, difference
from .decoder import decode
from .lattice import Crossings, lattice
from .response import Response

__all__ = ["Correspondence", "Crossings", "Flag", "Response", "decode", "difference", "lattice"]
