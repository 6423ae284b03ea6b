"""live: a prepared rig and one frame of a crossed fringe -> height with sigma, contacts, force.

| file | holds |
|---|---|
| `prepare.py`, `prepared.py` | prepare(): precomputation for a rig at rest; its record and file |
| `stream.py` | Live: one reading per frame |
| `reading.py`, `verdict.py` | results of a frame; whether they are valid |
| `chain.py` | one frame, from the image to the height |
| `picture.py`, `unwrap.py` | the model of the image and its fit; phase unwrapping |
| `geometry.py`, `chord.py`, `columns.py` | rays and anchor; a step of the coupled equations; its solver |
| `contact.py`, `touches.py`, `pressure.py` | figures of a contact; contacts over time; pressure and force |
| `circulation.py` | circulation of the slopes: their inconsistency |
| `source.py`, `follow.py` | cameras, one of them virtual; readings as an iterator, tare |
| `ring.py` | Ring: a code of several frames, one height per frame |
| `server.py`, `page.html` | the page |
| `arrays.py` | names of arrays |
"""

from optolever.arguments import check_face

from .contact import Force, Touch
from .follow import Followed, follow, tared
from .prepare import prepare
from .prepared import Noise, Prepared
from .pressure import Forces
from .reading import Figures, Reading
from .ring import Ring
from .server import LiveServer
from .source import Newest, Source, VirtualFinger, virtual_rig
from .stream import Live
from .touches import Touches

__all__ = [
    "Figures",
    "Followed",
    "Force",
    "Forces",
    "Live",
    "LiveServer",
    "Newest",
    "Noise",
    "Prepared",
    "Reading",
    "Ring",
    "Source",
    "Touch",
    "Touches",
    "VirtualFinger",
    "follow",
    "prepare",
    "tared",
    "virtual_rig",
]

check_face(__name__)
