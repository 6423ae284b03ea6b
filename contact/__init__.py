"""contact: a map less rest, as arrays -> contacts: place, depth, area, volume, radius, force, with sigmas.

| file | holds |
|---|---|
| `surface.py` | Surface: the map, whichever part measured it |
| `regions.py` | regions(): which dents there are, and the cells of each |
| `sag.py` | sag(): how far everything sank and the rig moved; the far field of contacts |
| `contacts.py` | contacts(): their figures |
| `pressure.py` | pressure and force by the elasticity of the layer |
| `arrays.py` | names of arrays |
"""

from optolever.arguments import check_face

from .contacts import Contact, contacts
from .regions import Region, regions
from .sag import far_field, sag
from .surface import Sag, Surface

__all__ = ["Contact", "Region", "Sag", "Surface", "contacts", "far_field", "regions", "sag"]

check_face(__name__)
