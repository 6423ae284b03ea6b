"""Brute force: many rays per pixel through scene.trace, each one's light summed over the pattern's cells."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from optolever.patterns import Sequence
from optolever.scene import Camera, PinholeCamera, Scene, Surface, trace

Float = NDArray[np.float64]


def part(camera: Camera, row: int, col: int, rows: int, cols: int) -> Camera:
    """Pixels (row .. row + rows, col .. col + cols) of a camera."""
    if isinstance(camera, PinholeCamera):
        return replace(camera, centre=camera.centre - np.array([col, row]), rows=rows, cols=cols)
    shift = col * camera.pitch[0] * camera.u_axis + row * camera.pitch[1] * camera.v_axis
    return replace(camera, origin=camera.origin + shift, rows=rows, cols=cols)


def finer(camera: Camera, times: int) -> Camera:
    """The same field of view with times x times as many pixels."""
    rows, cols = camera.rows * times, camera.cols * times
    if isinstance(camera, PinholeCamera):
        centre = (camera.centre + 0.5) * times - 0.5
        return replace(camera, rows=rows, cols=cols, focal=camera.focal * times, centre=centre)
    pitch = camera.pitch / times
    corner = camera.origin - 0.5 * (camera.pitch[0] * camera.u_axis + camera.pitch[1] * camera.v_axis)
    origin = corner + 0.5 * (pitch[0] * camera.u_axis + pitch[1] * camera.v_axis)
    return replace(camera, rows=rows, cols=cols, origin=origin, pitch=pitch)


def light_of_rays(images: Float, u: Float, v: Float, blur: float) -> Float:
    """Light (N, P) of images (N, rows, cols) at points u, v (P,) through a Gaussian of `blur` cells."""
    reach = int(np.ceil(6 * blur)) if blur > 0 else 0
    padded = np.pad(images, ((0, 0), (reach + 1, reach + 1), (reach + 1, reach + 1)))
    at_u, at_v = np.rint(u).astype(int), np.rint(v).astype(int)
    total = np.zeros((len(images), u.size))
    for j in range(-reach, reach + 1):
        for k in range(-reach, reach + 1):
            weight = _weight(at_v + j, v, blur) * _weight(at_u + k, u, blur)
            total += weight * padded[:, at_v + j + reach + 1, at_u + k + reach + 1]
    return total


def _weight(cell: NDArray[np.int64], at: Float, blur: float) -> Float:
    if blur == 0:
        return np.ones_like(at)
    return ndtr((cell + 0.5 - at) / blur) - ndtr((cell - 0.5 - at) / blur)


def supersampled(scene: Scene, surface: Surface, sequence: Sequence, times: int) -> Float:
    """Light (N, H, W), 0..1, averaged over times x times rays per pixel."""
    levels = sequence.render().astype(np.float64)
    images = levels / 255 if scene.display is None else scene.display.light(levels)
    seen = trace(replace(scene, camera=finer(scene.camera, times)), surface)
    light = np.zeros((len(images), *seen.u.shape))
    at = seen.visible
    passed = 1.0 if scene.medium is None else scene.medium.reflectance(np.cos(seen.incidence[at]))
    light[:, at] = passed * light_of_rays(images, seen.u[at], seen.v[at], scene.pattern.blur_px)
    rows, cols = scene.camera.rows, scene.camera.cols
    return light.reshape(len(images), rows, times, cols, times).mean(axis=(2, 4))
