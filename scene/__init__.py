"""scene: the physical setup, in mm and the mirror's frame, and its exact ray tracing.

Mirror frame: the resting mirror is z = 0, x from 0 (edge shared with the pattern face) to L0 (capture face),
y along the prism, z into the medium; a dent is z > 0. Integer pixel = pixel centre. Angles in rad, degrees in
TOML only.

| file | holds |
|---|---|
| `mirror.py` | mirror, its form at rest, medium (Fresnel), elastic layer |
| `sensor.py` | display and sensor response |
| `pattern.py` | the pattern's surface: flat, bowed, or a table of points |
| `cameras.py` | pixel -> ray, lens distortion, refraction at a face |
| `scene.py`, `toml_reading.py`, `presets/` | Scene, resize, window; strict TOML of a rig; scenes on board |
| `typed_rig.py` | a rig's TOML from sizes, angles and distances |
| `parameters.py`, `covariance.py` | the numbers that a calibration adjusts; how sure they are, typed or not |
| `surface.py` | Surface (height and gradient), Formula; height array as a bicubic spline |
| `dent_forms.py`, `dents.py` | closed forms of the dents; dents by name, or from an image |
| `tracing.py` | first meeting of ray and surface; Trace, trace; a pixel's movement |
| `drawing.py` | the rig from the side |
| `fields.py`, `pose.py` | fields declared with limit and key; x_A = T_AB x_B |
"""

from .cameras import Camera, Face, PinholeCamera, TelecentricCamera, prism_camera
from .covariance import TYPED, Accuracy, Covariance
from .dents import dent, dent_from_text, dent_names, dent_parameters
from .mirror import Layer, Medium, Mirror, RestForm, legendre_form, legendre_orders
from .parameters import (
    GAUGE_HELD,
    adjusted,
    parameter_changes,
    parameter_values,
    rig_covariance,
    shifted,
    typed_covariance,
    typed_sigmas,
    without_rest_form,
)
from .pattern import Bow, Pattern, PatternShape, PointTable, prism_pattern
from .scene import Scene, resize, scene_window, strided
from .sensor import MOSAICS, Display, Sensor
from .surface import Formula, Grid, Surface, surface_from_array
from .toml_reading import load, preset_names, rig_table, write_sections
from .tracing import Trace, mean_beside, movement, trace
from .typed_rig import TypedRig, rig_toml

__all__ = [
    "GAUGE_HELD", "MOSAICS", "TYPED", "Accuracy", "Bow", "Camera", "Covariance", "Display", "Face", "Formula",
    "Grid", "Layer", "Medium", "Mirror", "Pattern", "PatternShape", "PinholeCamera", "PointTable",
    "RestForm", "Scene", "Sensor", "Surface", "TelecentricCamera", "Trace", "TypedRig", "adjusted",
    "dent", "dent_from_text", "dent_names", "dent_parameters", "legendre_form", "legendre_orders",
    "load", "mean_beside", "movement", "parameter_changes", "parameter_values", "preset_names",
    "prism_camera", "prism_pattern", "resize", "rig_covariance", "rig_table", "rig_toml", "scene_window",
    "shifted", "strided", "surface_from_array", "trace", "typed_covariance", "typed_sigmas",
    "without_rest_form", "write_sections",
]  # fmt: skip
