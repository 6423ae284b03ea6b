"""live: a prepared rig and one frame of a crossed fringe -> height with sigma, contacts, force.

| file | holds |
|---|---|
| `prepare.py`, `prepared.py` | prepare(): precomputation for a rig at rest; its record and file |
| `stream.py` | Live: one reading per frame |
| `reading.py`, `verdict.py` | results of a frame; whether they are valid |
| `chain.py` | one frame, from the image to the height |
| `strays.py` | pixels that do not show the fringe, left out |
| `picture.py`, `unwrap.py` | the model of the image and its fit; phase unwrapping |
| `geometry.py`, `chord.py` | rays and anchor; a step of the coupled equations |
| `rig_motion.py` | the picture's shift and roll, and the load at the mirror's edge, in one fit |
| `rig_errors.py` | common error of heights by the rig's numbers |
| `touches.py`, `holes.py` | contacts over time; cells without a height |
| `probes.py`, `spectrum.py` | heights of single cells over time, the noise floor; their spectra |
| `circulation.py` | circulation of the slopes: their inconsistency |
| `source.py`, `follow.py` | cameras, one of them virtual; readings as an iterator, tare |
| `rig.py` | open(): a rig's camera as readings, its rest measured or kept |
| `outlet.py` | contacts as CSV, whole readings by a socket |
| `recorded.py` | readings beside their frames, and again from them |
| `server.py`, `web.py`, `page/` | the page's readings; its files, and who may ask for them |
| `arrays.py` | names of arrays |
"""

from .chain import COMPRESSED
from .follow import Followed, follow, tared
from .outlet import ContactTable, ReadingSocket
from .prepare import prepare
from .prepared import Noise, Prepared
from .probes import TRACES, Probe, Probed, Probes, noise_floor
from .reading import Figures, Reading
from .recorded import ReadingRecorder, Replayed, has_readings, replayed
from .rig import Readings, fringe_period, kept_rest
from .rig import open_rig as open
from .server import LiveServer
from .source import Newest, Source, VirtualFinger, virtual_rig
from .spectrum import Line, Spectrum, spectrum_of
from .stream import RESOLVED, Live
from .touches import Force, Touch, Touches
from .web import Web

__all__ = [
    "COMPRESSED", "RESOLVED", "TRACES", "ContactTable", "Figures", "Followed", "Force", "Line", "Live",
    "LiveServer", "Newest", "Noise", "Prepared", "Probe", "Probed", "Probes", "Reading",
    "ReadingRecorder", "ReadingSocket", "Readings", "Replayed", "Source", "Spectrum", "Touch",
    "Touches", "VirtualFinger", "Web", "follow", "fringe_period", "has_readings", "kept_rest",
    "noise_floor", "open", "prepare", "replayed", "spectrum_of", "tared", "virtual_rig",
]  # fmt: skip
