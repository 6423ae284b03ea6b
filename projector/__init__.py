"""projector: puts a sequence on a surface and brings frames back: windows, virtual sensor, folders.

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
| `capture.py`, `folder.py` | `Capture` and its folder format |
| `incoming.py` | pictures of other programs: which files, in which order, as which levels |
| `acquisition/` | an image for every pattern: clocks, synchronisation, exposure |
| `recording.py` | recordings |
| `rig.py` | `[devices]` of a rig, opened |
| `cameras/` | back-ends of cameras |
"""

from .acquisition import (
    SAFE_WAIT_S,
    Aim,
    Arrivals,
    ClockMap,
    Contrast,
    FlipRecord,
    Stamp,
    Taken,
    Timing,
    acquire,
    aim,
    choose_exposure,
    contrast,
    fit_timing,
    sync_notices,
    synchronise,
)
from .capture import Capture
from .context import ContextInfo, NoContextError, context_info
from .devices import Accepted, Camera, CameraLost, Display, Identity, Image, RealTime, Shown, Time, Wanted
from .display import PatternWindow, monitors
from .electronics import NOMINAL_SENSOR, WHITE_NOISE_SENSOR
from .folder import picture_files, write_description
from .monitors import Monitor, choose_monitor
from .optics_numpy import Footprints, footprints, light_of
from .recording import BackgroundRecorder, Logged, Recorder, Recording
from .renderer import PatternRenderer
from .rig import Devices, Opened, devices_of, opened, timing_of
from .virtual import RENDERERS, capture, chosen_renderer

__all__ = [
    "NOMINAL_SENSOR", "RENDERERS", "SAFE_WAIT_S", "WHITE_NOISE_SENSOR", "Accepted", "Aim", "Arrivals",
    "BackgroundRecorder", "Camera", "CameraLost", "Capture", "ClockMap", "ContextInfo", "Contrast",
    "Devices", "Display", "FlipRecord", "Footprints", "Identity", "Image",
    "Logged", "Monitor", "NoContextError", "Opened", "PatternRenderer", "PatternWindow", "RealTime",
    "Recorder", "Recording", "Shown", "Stamp", "Taken", "Time", "Timing", "Wanted", "acquire", "aim",
    "capture", "choose_exposure", "choose_monitor", "chosen_renderer", "context_info", "contrast",
    "devices_of", "fit_timing", "footprints", "light_of", "monitors", "opened",
    "picture_files", "sync_notices", "synchronise", "timing_of", "write_description",
]  # fmt: skip
