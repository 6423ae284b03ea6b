"""calibration: captures of simple targets -> a scene with covariance.

| file | holds |
|---|---|
| `calibrate.py` | calibrate(): the stages, the result |
| `targets.py` | Flat, Rest, Ball, Plate: form, unknowns, priors |
| `observation.py` | a capture of a target, checks, the pixels that the adjustment uses |
| `contact.py` | the contact of a pressed ball with the mirror |
| `priors.py` | priors of a scene's parameters: free, fixed, or known with a sigma; the gauge |
| `adjust.py` | the bundle adjustment and its covariance |
| `initial_pose.py` | closed-form start values, in open air |
| `judgement.py` | contribution of each capture to the accuracy |
| `rest.py` | the height map of the mirror at rest, stored with the rig; drift |
| `response.py` | response, blur, vignetting and backlight of display and camera, stored with the rig |
| `mix.py` | mix and curves of the channels of display and camera, stored with the rig |
| `error_budget.py` | the independent errors behind the covariance |
| `observability.py` | singular values in prior units, notices |
| `typed_faults.py` | typed numbers that contradict the camera |
| `weights.py` | the modulus of an elastic layer by known weights |
| `predicted.py` | sigma of a rig at rest and of a dent, before any capture; by errors of the parameters |
"""

from .calibrate import Calibration, calibrate, left_out
from .contact import contact
from .judgement import Judgement, SoFar, calibrate_so_far, judged, reason_to_repeat
from .mix import load_colours, measure_colours, store_colours
from .observation import Observation
from .predicted import PREDICTED_DEPTH, PREDICTED_NOISE, predicted_budget, predicted_maps, sigma_at_rest
from .priors import default_priors, unused_accuracy
from .response import RigResponse, load_response, measure_response, store_response, with_better_fit
from .rest import load_rest, store_rest
from .targets import Ball, Flat, Plate, Rest, Target, target_from_text
from .typed_faults import aim_fault, rest_fault
from .weights import Weighed, Weight, weighed

__all__ = [
    "PREDICTED_DEPTH", "PREDICTED_NOISE", "Ball", "Calibration", "Flat", "Judgement", "Observation",
    "Plate", "Rest", "RigResponse", "SoFar", "Target", "Weighed", "Weight", "aim_fault",
    "calibrate", "calibrate_so_far", "contact", "default_priors", "judged", "left_out",
    "load_colours", "load_response", "load_rest", "measure_colours", "measure_response",
    "predicted_budget", "predicted_maps", "reason_to_repeat", "rest_fault", "sigma_at_rest",
    "store_colours", "store_response", "store_rest", "target_from_text", "unused_accuracy",
    "weighed", "with_better_fit",
]  # fmt: skip
