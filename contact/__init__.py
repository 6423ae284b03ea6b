"""contact: a map less rest, as arrays -> contacts: place, depth, area, volume, radius, force, with sigmas.

| file | holds |
|---|---|
| `surface.py` | Surface: the map, whichever part measured it |
| `regions.py` | regions(): which dents there are, and the cells of each |
| `far_field.py` | load_fit(): sinking and motion of the rig; far fields of contacts, fit() of them |
| `elastic.py` | elastic_fits(): place, radius, depth, force by the elastic field around a contact |
| `contacts.py` | contacts(): their figures |
| `pressure.py` | pressure and force by the elasticity of the layer |
"""

from .contacts import Contact, contacts
from .elastic import ElasticFit, elastic_fits
from .far_field import far_field, fit, load_fit
from .regions import Region, regions
from .surface import LoadFit, Surface

__all__ = [
    "Contact", "ElasticFit", "LoadFit", "Region", "Surface", "contacts", "elastic_fits", "far_field",
    "fit", "load_fit", "regions",
]  # fmt: skip
