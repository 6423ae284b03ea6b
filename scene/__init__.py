"""scene: the physical setup, in mm and the mirror's frame, and its exact ray tracing.

Mirror frame: the resting mirror is z = 0, x from 0 (edge shared with the pattern face) to L0 (capture face),
y along the prism, z into the medium; a dent is z > 0. Integer pixel = pixel centre. Angles in rad, degrees in
TOML only.

| file | holds |
|---|---|
| `mirror.py`, `pattern.py`, `medium.py`, `sensor.py` | records; Fresnel; display and sensor response |
| `layer.py` | the elastic layer whose boundary is the mirror |
| `pattern_shape.py` | displays that are not flat: bow, table of points |
| `cameras.py`, `face.py` | pixel -> ray, lens distortion, refraction at a face |
| `scene.py`, `reading.py`, `presets/` | Scene, resize; strict TOML of a rig; the scenes on board |
| `typed_rig.py` | a rig's TOML from sizes, angles and distances |
| `parameters.py`, `covariance.py` | the numbers that a calibration adjusts; how sure they are |
| `accuracy.py`, `priors.py` | how sure typed numbers are; the covariance that every scene has |
| `surface.py`, `grid.py` | Surface (height and gradient), Formula; height array as a bicubic spline |
| `forms.py`, `dents.py`, `relief.py` | closed forms of the dents; dents by name; a dent from an image |
| `meeting.py`, `tracing.py` | first meeting of ray and surface; Trace, trace |
| `drawing.py` | the rig from the side |
| `window.py` | a part of the image as a camera; how far the view moves across a pixel |
| `record.py`, `pose.py` | fields declared with limit and key; x_A = T_AB x_B |
"""

from optolever.arguments import check_face

from .accuracy import TYPED, Accuracy
from .cameras import Camera, PinholeCamera, TelecentricCamera, prism_camera
from .covariance import Covariance
from .dents import dent, dent_from_text, dent_names, dent_parameters
from .face import Face
from .grid import Grid
from .layer import Layer
from .medium import Medium
from .mirror import Mirror, RestForm
from .parameters import adjusted, parameter_changes, parameter_values, without_rest_form
from .pattern import Pattern, prism_pattern
from .pattern_shape import Bow, PatternShape, PointTable
from .priors import GAUGE_HELD, rig_covariance, typed_covariance, typed_sigmas
from .reading import load, preset_names, rig_table, write_sections
from .scene import Scene, resize
from .sensor import Display, Sensor
from .surface import Formula, Surface, surface_from_array
from .tracing import Trace, trace
from .typed_rig import TypedRig, rig_toml
from .window import mean_beside, movement, scene_window, strided

__all__ = [
    "GAUGE_HELD", "TYPED", "Accuracy", "Bow", "Camera", "Covariance", "Display", "Face", "Formula",
    "Grid", "Layer", "Medium", "Mirror", "Pattern", "PatternShape", "PinholeCamera", "PointTable",
    "RestForm", "Scene", "Sensor", "Surface", "TelecentricCamera", "Trace", "TypedRig", "adjusted",
    "dent", "dent_from_text", "dent_names", "dent_parameters", "load", "mean_beside", "movement",
    "parameter_changes", "parameter_values", "preset_names", "prism_camera", "prism_pattern",
    "resize", "rig_covariance", "rig_table", "rig_toml", "scene_window", "strided",
    "surface_from_array", "trace", "typed_covariance", "typed_sigmas", "without_rest_form",
    "write_sections",
]  # fmt: skip

check_face(__name__)
