"""Contacts: what presses on the mirror, from a height map and its slopes.

| file | holds |
|---|---|
| `regions` | contacts(): depth, area, volume and position of every dent |
| `record` | Contact |
| `relief` | the map with holes interpolated, errors of the rig taken off |
| `dent` | one dent's pixels and its deepest point |
| `edge` | the edge of a contact, by what elastic contact does to the slopes |
| `load` | how far contacts make the surface around them sink |
"""

from .load import sink_around
from .record import Contact
from .regions import contacts

__all__ = ["Contact", "contacts", "sink_around"]
