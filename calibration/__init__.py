"""calibration: captures of simple targets -> a scene with covariance.

| file | holds |
|---|---|
| `calibrate.py` | calibrate(): the stages, the result |
| `targets.py` | Flat, Rest, Ball, Plate, Points: form, own unknowns, priors |
| `observation.py` | a capture of a target, checks, the sample that is used |
| `contact.py` | where a pressed ball touches the mirror |
| `priors.py` | what is free, held or known of a scene; the gauge |
| `model.py` | where pixels look by a target |
| `adjust.py` | the bundle adjustment and its covariance |
| `start.py` | a start without a guess, in open air |
| `judgement.py` | what every capture is worth, one by one |
| `rest.py` | the map of the mirror at rest, kept with the rig; drift |
| `response.py` | response, blur, vignetting and backlight of display and camera, kept with the rig |
| `profile.py` | a decoder's profile of the rig, kept with it |
| `harmonics.py` | error of the coordinate by harmonics that a response leaves in fringes |
| `sources.py` | the independent errors behind the covariance |
| `observability.py` | singular values in prior units, notices |
| `effects.py` | what errors of the numbers do to heights and depths |
"""

from optolever.arguments import check_face

from .calibrate import Calibration, calibrate, left_out
from .contact import contact
from .harmonics import HarmonicError, harmonic_errors
from .judgement import Judgement, as_they_come, judged
from .observation import Observation
from .priors import default_priors
from .profile import load_profile, store_profile
from .response import RigResponse, load_response, measure_response, store_response, with_better_fit
from .rest import RestMap, load_rest, store_rest
from .targets import Ball, Flat, Plate, Points, Rest, Target

__all__ = [
    "Ball",
    "Calibration",
    "Flat",
    "HarmonicError",
    "Judgement",
    "Observation",
    "Plate",
    "Points",
    "Rest",
    "RestMap",
    "RigResponse",
    "Target",
    "as_they_come",
    "calibrate",
    "contact",
    "default_priors",
    "harmonic_errors",
    "judged",
    "left_out",
    "load_profile",
    "load_response",
    "load_rest",
    "measure_response",
    "store_profile",
    "store_response",
    "store_rest",
    "with_better_fit",
]

check_face(__name__)
