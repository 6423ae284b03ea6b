"""What a nonlinear display or camera does to a fringe that is decoded as if it were a cosine."""

import numpy as np

from optolever.scene import Scene

from .fringes import Fringe
from .view import Floats, View

__all__ = ["fundamental_share", "harmonic_error"]

SAMPLES = 256
HARMONICS = 12


def harmonic_error(view: View, fringe: Fringe, axis: str) -> Floats:
    """Decoded minus true coordinate, cells (H, W), from the harmonics that display and camera add.

    The response of both, as one function of the cosine, has cosine harmonics b_k; under the optics each keeps
    its own contrast M_k. With N shifts the solve sees sum_k b_k M_k cos(k (phase - d_i)) in sample i.
    """
    scene = view.scene
    coord = view.coordinate(axis)
    if _linear(scene):
        return np.zeros(coord.shape)
    angle = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    harmonics = np.fft.rfft(_response(scene, angle)).real[: HARMONICS + 1] / SAMPLES * 2
    width = tuple(float(np.nanmedian(w)) for w in view.widths[axis])
    left = _contrasts(fringe.period, width, scene.pattern.blur_px)
    phase = angle[:, None] - fringe.shifts
    seen = 0.5 * harmonics[0] + sum(
        harmonics[k] * left[k] * np.cos(k * phase) for k in range(1, HARMONICS + 1)
    )
    _, c, s = fringe.solve() @ (fringe.exposure * seen).T
    error = np.angle(np.exp(1j * (np.arctan2(s, c) - angle))) * fringe.period / (2 * np.pi)
    at = np.nan_to_num(coord) / fringe.period % 1.0
    table: Floats = np.interp(at, np.append(angle, 2 * np.pi) / (2 * np.pi), np.append(error, error[0]))
    return table


def fundamental_share(scene: Scene) -> float:
    """Amplitude of a full fringe over half the step from black to white: 1 for a linear response."""
    if _linear(scene):
        return 1.0
    angle = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    level = _response(scene, angle)
    return float(np.fft.rfft(level).real[1] / SAMPLES * 4 / np.ptp(level))


def _linear(scene: Scene) -> bool:
    return (scene.display is None or scene.display.gamma == 1.0) and (
        scene.sensor is None or scene.sensor.gamma == 1.0
    )


def _response(scene: Scene, angle: Floats) -> Floats:
    """Level of a fully reflecting pixel where the fringe has an angle."""
    shown = 127.5 * (1 + np.cos(angle))
    light = shown / 255 if scene.display is None else scene.display.light(shown)
    return light if scene.sensor is None else scene.sensor.levels(light)


def _contrasts(period: float, widths: tuple[float, ...], blur: float) -> list[float]:
    """Contrast of harmonics 0, 1, ... of a period."""
    left = []
    for k in range(HARMONICS + 1):
        f = k / period
        pixel = np.sinc(f) * np.sinc(f * widths[0]) * np.sinc(f * widths[1])
        left.append(float(pixel * np.exp(-2 * (np.pi * blur * f) ** 2)))
    return left
