"""Contacts: what presses on the mirror, from a height map and its slopes.

| file | holds |
|---|---|
| `regions.py` | contacts(): depth, area, volume and position of every dent |
| `record.py` | Contact |
| `relief.py` | the map with holes interpolated and common errors of the rig levelled |
| `peaks.py` | which dents there are: persistence of the height's maxima |
| `rim.py` | the surroundings of a dent, and what they say of the rig's errors |
| `dent.py` | one dent's pixels |
| `deepest.py` | its deepest point |
| `edge.py` | the edge of a contact, by what elastic contact does to the slopes |
| `load.py` | how far contacts make the surface around them sink |
"""

from .load import sink_around
from .record import Contact
from .regions import contacts

__all__ = ["Contact", "contacts", "sink_around"]
