"""projector: puts a sequence on a surface: windows, virtual sensor, captures as folders.

| file | holds |
|---|---|
| `context.py`, `shaders.py`, `shaders/` | the OpenGL context (EGL first); shader files and their flags |
| `renderer.py` | frames drawn offscreen, bit-equal to NumPy's |
| `display.py`, `window.py` | the same in a real window, in a separate process |
| `monitors.py` | monitors by name; settings that distort levels |
| `devices.py` | records and protocols of cameras, displays, clocks |
| `virtual.py` | `capture`: images of a scene with a dent, strip by strip |
| `groups.py`, `footprint.py` | frames looked up together; light of the cells under a pixel's footprint |
| `optics_gl.py`, `surface_gl.py`, `optics_numpy.py`, `rays.py` | light on the sensor: GLSL; float64 |
| `electronics.py` | exposure, flicker, response, noise, quantisation: one function for both |
| `colour_sensor.py` | the same in colour: crosstalk, stripes, mosaics |
| `capture.py`, `colour_capture.py`, `unmixing.py` | `Capture`; pictures of three frames each, unmixed |
| `folder.py` | a capture as a folder, described by its `capture.toml` |
| `reading.py` | pictures of a folder, of others too: which files, in which order, as which levels |
"""

from .capture import Capture
from .colour_capture import ColourCapture, load_capture
from .colour_sensor import capture_colour, exact_response
from .context import ContextInfo, NoContextError, context_info
from .devices import (
    Accepted,
    Camera,
    CameraLost,
    Display,
    Identity,
    Image,
    RealTime,
    Shown,
    Time,
    Wanted,
    no_pixels,
)
from .display import PatternWindow, monitors
from .electronics import NOMINAL_SENSOR, WHITE_NOISE_SENSOR, FrameElectronics
from .folder import in_colour, write_description
from .monitors import Monitor, choose_monitor
from .optics_numpy import Footprints, footprints, light_of
from .reading import picture_files
from .renderer import PatternRenderer
from .unmixing import ColourResponse, quads, unmixed
from .virtual import RENDERERS, capture, chosen_renderer

__all__ = [
    "NOMINAL_SENSOR", "RENDERERS", "WHITE_NOISE_SENSOR", "Accepted", "Camera",
    "CameraLost", "Capture", "ColourCapture", "ColourResponse", "ContextInfo", "Display", "Footprints",
    "FrameElectronics", "Identity", "Image", "Monitor", "NoContextError", "PatternRenderer", "PatternWindow",
    "RealTime", "Shown", "Time", "Wanted", "capture", "capture_colour", "choose_monitor", "chosen_renderer",
    "context_info", "exact_response", "footprints", "in_colour", "light_of", "load_capture", "monitors",
    "no_pixels", "picture_files", "quads", "unmixed", "write_description",
]  # fmt: skip
