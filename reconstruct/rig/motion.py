"""Motion of the rig between rest and press: errors of its prior, limited by the height where nothing presses.

It is not taken off: a body that bulges or sinks under the load moves the image as a rig does. The rms s of
the height there limits its modes of height B, of the width w = max(1, s / rms B), to the covariance
(1/w^2 + <B B^T> / s^2)^-1.
"""

import numpy as np
from scipy import ndimage

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.scene import Scene, adjusted, strided

from ..arrays import Floats, Mask
from ..outputs.coarse_modes import filled
from .calibration import flat_mirror

__all__ = ["limited_motion", "motion_shifts", "unpressed"]

_IMAGE, _TURN, _SHIFT = 0.02, 2.4e-5, 1e-3  # of the prior: camera pixels, rad (5 arcsec), mm
_WEAK, _LIMIT, _CHANCE = 1e-3, 3.0, 4.0  # of the largest mode; standard deviations: prior, noise
_ROUNDS, _SAMPLE, _TINY = 12, 20000, 1e-5  # of the robust fit: steps, pixels; pattern px
_BLOCK, _QUIET = 5, 0.25  # pixels; of the pixels: fewer are a dent's rim
_CURE = "the total sigma holds it; clamp the rig, capture at rest again; or the body sinks as a whole"


def motion_shifts(press: Correspondence, scene: Scene, step: int) -> Floats:
    """Changes of u and v (k, 2, rows, cols) by motions of one standard deviation, on every step-th pixel of
    the camera; press: of those pixels, which the image's motion shifts. Gaps take the nearest values."""
    small = strided(scene, step)
    flat = flat_mirror(small)
    sizes = {axis: _TURN if axis[0] == "r" else _SHIFT for axis in ("x", "y", "z", "rx", "ry", "rz")}
    poses = [(f"{part}.{axis}", size) for part in ("camera", "pattern") for axis, size in sizes.items()]
    fields = [flat_mirror(adjusted(small, {name: size})) - flat for name, size in poses]
    places = np.stack([np.where(press.good, at, np.nan) for at in (press.u, press.v)])
    fields += [_IMAGE / step * np.gradient(places, axis=axis) for axis in (1, 2)]
    whole = filled(np.reshape(fields, (-1, *flat.shape[1:])))
    _, values, modes = np.linalg.svd(whole.reshape(len(fields), -1).astype(np.float64), full_matrices=False)
    strong: Floats = (values[:, None] * modes)[values > _WEAK * values.max()]
    return strong.reshape(-1, *flat.shape)


def limited_motion(
    modes: Floats, motions: int, z: Floats, sigma: Floats, still: Mask
) -> tuple[Floats, tuple[Notice, ...]]:
    """The modes (r, rows, cols) of a map against rest, the last ones, of the motion, limited by the height z,
    of noise sigma, where nothing presses (rows, cols); and the notice of a motion beyond its prior."""
    common, own = modes[:-motions], modes[-motions:]
    quiet = still & np.isfinite(own).all(axis=0) & np.isfinite(z)
    if not quiet.any():
        return modes, ()
    at = own[:, quiet]
    gram = at @ at.T / at.shape[1]
    rms = float(np.sqrt(np.mean(z[quiet] ** 2)))
    wider = max(1.0, rms / float(np.sqrt(np.trace(gram))))
    size = np.hypot(rms, float(np.median(sigma[quiet])))
    covariance = np.linalg.inv(np.eye(len(gram)) / wider**2 + gram / size**2)
    limited = np.tensordot(np.linalg.cholesky(covariance).T, own, 1)
    name = f"Where nothing presses, heights change by {1e3 * rms:.2g} um (rms); standard deviations of motion"
    found = (Notice(name, wider, _LIMIT, _CURE),) if wider > _LIMIT else ()
    return np.concatenate([common, limited]), found


def unpressed(pressed: Correspondence, rest: Correspondence) -> tuple[Mask, float, float]:
    """Pixels (H, W) where nothing presses, as a robust paraboloid explains press less rest (none where they
    are few, as of a dent all over); its rms there, pattern px, and its size over its noise."""
    if pressed.u.shape != rest.u.shape:
        raise InputError(f"pressed, rest: {pressed.u.shape}, {rest.u.shape} pixels; must be of one camera")
    quiet = both = pressed.good & rest.good
    row, col = (2.0 * at / size - 1 for at, size in zip(np.indices(both.shape), both.shape, strict=True))
    terms = np.stack([np.ones_like(row), row, col, row * row, row * col, col * col], axis=-1)
    some, changes = both & (np.arange(both.size) % max(1, both.size // _SAMPLE) == 0).reshape(both.shape), []
    for axis in ("u", "v") if some.any() else ():
        noise = np.hypot(getattr(pressed, f"sigma_{axis}"), getattr(rest, f"sigma_{axis}"))
        noise = np.where(both, np.maximum(noise, _TINY), 1.0)
        y = np.where(both, getattr(pressed, axis) - getattr(rest, axis), 0.0)
        left = y
        for scale in np.geomspace(max(1.0, float(np.abs(y / noise).max())), 1.0, _ROUNDS):
            variance = noise[some] ** 2 + (left[some] / scale) ** 2
            left = np.where(both, y - terms @ _fitted(terms[some], y[some], variance)[0], 0.0)
        # the mean over a block of pixels shows slopes below the noise of one
        loud = np.abs(ndimage.uniform_filter(left / noise, _BLOCK)) * _BLOCK > _CHANCE
        quiet = quiet & ~ndimage.binary_dilation(loud, iterations=_BLOCK)
        changes.append((y, noise))
    if quiet.sum() < max(_QUIET * both.sum(), 1):
        return np.zeros_like(both), 0.0, 0.0
    at = terms[quiet]
    fits = [_fitted(at, y[quiet], noise[quiet] ** 2) for y, noise in changes]
    px = np.sqrt(np.mean([np.square(at @ fit) for fit, _ in fits]))
    return quiet, float(px), float(np.sqrt(np.mean([fit @ normal @ fit / 6 for fit, normal in fits])))


def _fitted(terms: Floats, y: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Weighted least squares: the factors (6,), and the normal equations' matrix."""
    normal: Floats = (terms.T / variance) @ terms
    return np.asarray(np.linalg.lstsq(normal, (terms.T / variance) @ y, rcond=None)[0], float), normal
