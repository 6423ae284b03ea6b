"""projector: puts a sequence on a surface and brings frames back: windows, virtual sensor, folders.

| file | holds |
|---|---|
| `context.py`, `shaders.py`, `shaders/` | the OpenGL context (EGL first); shader files and their flags |
| `renderer.py`, `window.py` | frames drawn offscreen, bit-equal to NumPy's; the same in a real window |
| `virtual.py` | `capture`, `VirtualSensor`: a scene with a dent seen by its camera, strip by strip |
| `groups.py`, `footprint.py` | frames looked up together; light of the cells under a pixel's footprint |
| `optics_gl.py`, `surface_gl.py`, `optics_numpy.py`, `rays.py` | light on the sensor: GLSL; float64 |
| `raytraced.py` | frames by rays through every pixel's area, for tests of what assumes something of a pixel |
| `electronics.py` | exposure, flicker, response, noise, quantisation: one function for both |
| `capture.py`, `folder.py`, `source.py` | `Capture`, its folder format, and the seam for real cameras |
| `incoming.py` | pictures of other programs: which files, in which order, as which levels |
| `sofast.py` | SOFAST's HDF5 measurements as captures |
| `benchmark.py` | frames per second on the context at hand |
"""

from optolever.arguments import check_face

from .benchmark import RendererSpeed, measure_renderer
from .capture import Capture
from .context import ContextInfo, NoContextError, context_info, release_context
from .electronics import NOMINAL_SENSOR
from .folder import write_description
from .optics_numpy import Footprints, footprints, light_of
from .raytraced import AreaTrace, Lighting, area_frames, area_light, expose, trace_area
from .renderer import PatternRenderer, render
from .sofast import load_sofast, load_sofast_response
from .source import FolderSource, FrameSource, PatternDisplay, record
from .virtual import RENDERERS, VirtualSensor, capture, chosen_renderer
from .window import Monitor, PatternWindow, monitors

__all__ = [
    "NOMINAL_SENSOR",
    "RENDERERS",
    "AreaTrace",
    "Capture",
    "ContextInfo",
    "FolderSource",
    "Footprints",
    "FrameSource",
    "Lighting",
    "Monitor",
    "NoContextError",
    "PatternDisplay",
    "PatternRenderer",
    "PatternWindow",
    "RendererSpeed",
    "VirtualSensor",
    "area_frames",
    "area_light",
    "capture",
    "chosen_renderer",
    "context_info",
    "expose",
    "footprints",
    "light_of",
    "load_sofast",
    "load_sofast_response",
    "measure_renderer",
    "monitors",
    "record",
    "release_context",
    "render",
    "trace_area",
    "write_description",
]

check_face(__name__)
