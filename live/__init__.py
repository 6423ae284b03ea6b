"""live: a prepared rig and one frame of a crossed fringe -> height with sigma, contacts, force.

| file | holds |
|---|---|
| `stream.py` | Live: one reading per frame |
| `reading.py`, `verdict.py` | results of a frame; whether they are valid |
| `touches.py`, `holes.py` | contacts over time; cells without a height |
| `probes.py`, `spectrum.py` | heights of single cells over time, the noise floor; their spectra |
| `source.py`, `follow.py` | cameras, one of them virtual; readings as an iterator, tare |
| `open_rig.py` | open(): a rig's camera as readings, its rest measured or kept |
| `recorded.py` | readings beside their frames, and again from them |
| `fringe/` | the picture of a crossed fringe, and one frame of it to a height |
| `rest/` | prepare(): a rig at rest, prepared for live frames; what has moved since |
| `serve/` | the page; contacts as CSV, readings by a socket |
"""

from .follow import Followed, follow, tared
from .fringe.chain import COMPRESSED
from .open_rig import Readings, fringe_period, kept_rest
from .open_rig import open_rig as open
from .probes import TRACES, Probe, Probed, Probes, noise_floor
from .reading import Figures, Reading
from .recorded import ReadingRecorder, Replayed, has_readings, replayed
from .rest.prepare import prepare
from .rest.prepared import Noise, Prepared
from .serve.outlet import ContactTable, ReadingSocket
from .serve.server import LiveServer
from .serve.web import Web
from .source import Newest, Source, VirtualFinger, virtual_rig
from .spectrum import Line, Spectrum, spectrum_of
from .stream import RESOLVED, Live
from .touches import Force, Touch, Touches

__all__ = [
    "COMPRESSED", "RESOLVED", "TRACES", "ContactTable", "Figures", "Followed", "Force", "Line", "Live",
    "LiveServer", "Newest", "Noise", "Prepared", "Probe", "Probed", "Probes", "Reading",
    "ReadingRecorder", "ReadingSocket", "Readings", "Replayed", "Source", "Spectrum", "Touch",
    "Touches", "VirtualFinger", "Web", "follow", "fringe_period", "has_readings", "kept_rest",
    "noise_floor", "open", "prepare", "replayed", "spectrum_of", "tared", "virtual_rig",
]  # fmt: skip
