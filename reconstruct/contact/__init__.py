"""Contacts: what presses on the mirror, from a height map and its slopes.

| file | holds |
|---|---|
| `regions.py` | contacts(): depth, area, volume, centroid |
| `dent.py` | one dent's pixels |
| `edge.py` | the edge of a contact, by what elastic contact does to the slopes |
"""

from .regions import Contact, contacts

__all__ = ["Contact", "contacts"]
