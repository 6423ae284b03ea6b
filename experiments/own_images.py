"""A user's patterns that vary along both axes, as images, and the user's decoder for them.

OwnImages are rendered from a white and a black frame, each pixel with the level of the blurred image at its
coordinates: a point, no footprint.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence
from optolever.projector import NOMINAL_SENSOR, capture
from optolever.scene import Display, Scene, Surface, Trace

from .faults import with_noise, without_noise
from .own_function import imported

__all__ = ["OwnDecoder", "OwnImages", "image_frames", "own_decoder"]

Levels = NDArray[np.uint8]
#: From frames (N, H, W) and their Sequence or images (N, rows, cols) to a correspondence.
OwnDecoder = Callable[[NDArray[Any], "Sequence | Levels"], Correspondence]


@dataclass(frozen=True, slots=True, eq=False)
class OwnImages:
    """Images (N, rows, cols) uint8 for a surface of rows x cols cells, and their name."""

    levels: Levels
    name: str

    def __len__(self) -> int:
        return len(self.levels)


def image_frames(
    scene: Scene,
    surface: Surface,
    truth: Trace,
    shown: OwnImages,
    lag: float,
    noise: float,
    seed: int,
    renderer: str,
) -> Levels:
    """Frames (N, H, W) of a mirror that reflects the images, with noise in 8-bit levels."""
    rows, cols = shown.levels.shape[1:]
    ends = Sequence((Frame("white"), Frame("black")), rows, cols)
    quiet = without_noise(scene)
    white, black = capture(quiet, surface, ends, renderer=renderer, bits=16).frames.astype(np.float32) / 257
    display = scene.display or Display()
    light = display.light(shown.levels.astype(np.float64))
    light = (light - display.black) / (1 - display.black)
    seen = np.where(truth.visible, [truth.v, truth.u], -10.0)
    frames = np.empty((len(shown), *white.shape), np.float32)
    for frame, image in zip(frames, light, strict=True):
        soft = scipy.ndimage.gaussian_filter(image, scene.pattern.blur_px)
        frame[:] = black + (white - black) * scipy.ndimage.map_coordinates(
            soft, seen, order=1, mode="constant"
        )
    for before, after in zip(frames[:-1].copy(), frames[1:], strict=True):
        after += np.float32(lag) * (before - after)
    return with_noise(frames, scene.sensor or NOMINAL_SENSOR, noise, seed)


def own_decoder(text: str) -> OwnDecoder:
    """The function behind 'module:function'. InputError where there is none, where it raises, and where it
    returns anything but a Correspondence of the frames' size."""
    function = imported(f"decoder {text!r}", text)

    def decode(frames: NDArray[Any], shown: "Sequence | Levels") -> Correspondence:
        try:
            found = function(frames, shown)
        except Exception as error:  # whatever a user's function raises is a finding about that function
            raise InputError(f"decoder {text!r}: raises {type(error).__name__}: {error}") from error
        if not isinstance(found, Correspondence):
            raise InputError(f"decoder {text!r}: returns {type(found).__name__}, must be a Correspondence")
        if found.u.shape != frames.shape[1:]:
            raise InputError(f"decoder {text!r}: returns {found.u.shape} pixels, must be {frames.shape[1:]}")
        return found

    return decode
