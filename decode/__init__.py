"""Frames + Sequence -> Correspondence. (map follows)"""

from .correspondence import Correspondence, Flag, difference
from .crossed import crossed
from .decoder import decode
from .lattice import Crossings, lattice
from .response import Response

__all__ = ["Correspondence", "Crossings", "Flag", "Response", "crossed", "decode", "difference", "lattice"]
