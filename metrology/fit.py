"""fit_form: a form fitted to the good pixels of a height map, its parameters with sigma, and the residual."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.errors import InputError
from optolever.reconstruct import Grid, HeightFlag, HeightMap, SlopeMap

from .apertures import middle_of
from .figures import pvr, rms_less_noise
from .forms import Form, form_from_text
from .functionals import SlopeNoise, modes_variance, noise_covariance, residual_noise, root_sigma

__all__ = [
    "FOREIGN", "FormFit", "Numbers", "covariances_of", "differences", "fit_form", "leftovers", "placed",
    "slope_noise",
]  # fmt: skip

#: Method of a map that was read from a grid.
FOREIGN = "grid"
_STEPS = 30
_STEEPEST = 1e3  # mm per mm: larger sigmas of slopes are no measurement
_SETTLED = 1e-9  # rms of the last step's change of the form over the rms residual, at convergence
_NUDGE = 1e-5  # step of differences over a parameter's scale
_ANCHORED = 1e-6  # relative response of a parameter to a piston, above which it depends on the anchor


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """Fitted parameters: names, values, standard deviations by noise (NaN: unknown) and by the errors of the
    rig (0: an exact scene, or unknown)."""

    names: tuple[str, ...]
    values: Floats
    noise: Floats
    rig: Floats

    @property
    def sigma(self) -> Floats:
        """Noise and rig combined."""
        return np.hypot(self.noise, self.rig)

    def to_dict(self) -> dict[str, dict[str, float]]:
        """By name: value, sigma, noise, rig."""
        rows = zip(self.names, self.values, self.sigma, self.noise, self.rig, strict=True)
        return {
            name: {"value": float(value), "sigma": float(sigma), "noise": float(noise), "rig": float(rig)}
            for name, value, sigma, noise, rig in rows
        }


@dataclass(frozen=True, slots=True, eq=False)
class FormFit:
    """A form fitted to a map. form: its name; numbers: fitted parameters; held: fixed parameters; x, y (H,
    W): mm; residual (H, W): heights less the form, mm, NaN where not good; middle: origin x = y = 0 of the
    form, mm in the mirror's frame.

    noise, rig (H, W): standard deviations of the residual by the slopes' noise (NaN: unknown) and by the
    errors of the rig, mm, each less its part in the form; variance: of the residual's mean square, by noise
    and rig, mm^4; step_variance: mean variance of an increment from pixel to pixel by noise, mm^2; trace:
    variance of the mean square of the noise, mm^4; modes (r, H, W): height errors by the rig less their part
    in the form, mm; basis (n, k): orthonormal heights of the n known pixels, which span the form's changes
    and a piston; slope_noise: of the map (None: unknown); passes: cutoff (mm) and 'low' or 'high' of each
    filter that was applied."""

    form: str
    numbers: Numbers
    held: dict[str, float]
    x: Floats
    y: Floats
    residual: Floats
    middle: tuple[float, float]
    noise: Floats
    rig: Floats
    variance: tuple[float, float]
    step_variance: float
    trace: float
    modes: NDArray[np.float32] | None
    basis: Floats
    slope_noise: SlopeNoise | None
    passes: tuple[tuple[float, str], ...] = ()

    @property
    def sigma(self) -> Floats:
        """Standard deviation of the residual (H, W), mm."""
        return np.hypot(self.noise, self.rig)

    @property
    def rms_less_noise(self) -> float:
        """Rms of the surface alone, mm; NaN if the noise is unknown."""
        known = self.noise[np.isfinite(self.residual)]
        return rms_less_noise(self.rms, float(np.sqrt(np.mean(known**2))))

    def rms_sigmas(self, rms: float) -> tuple[float, float]:
        """Standard deviations of rms or rms_less_noise, mm, by noise (NaN: unknown) and rig."""
        noise, rig = (root_sigma(rms, each) for each in self.variance)
        return noise, rig

    @property
    def pvr(self) -> float:
        """Robust peak to valley, mm (`figures.pvr`)."""
        known = np.isfinite(self.residual)
        return pvr(self.x[known], self.y[known], self.residual[known])

    @property
    def pv_sigmas(self) -> tuple[float, float]:
        """Standard deviations of pv, mm, by noise and rig: of the highest and the lowest pixel; of pvr, a
        bound."""
        ends = [np.nanargmax(self.residual), np.nanargmin(self.residual)]
        noise, rig = (float(np.hypot(*part.ravel()[ends])) for part in (self.noise, self.rig))
        return noise, rig

    @property
    def rms(self) -> float:
        """Rms of the residual about its mean, mm, unweighted."""
        return float(np.nanstd(self.residual))

    @property
    def pv(self) -> float:
        """Largest less smallest residual, mm."""
        return float(np.nanmax(self.residual) - np.nanmin(self.residual))

    @property
    def slopes(self) -> tuple[Floats, Floats]:
        """dz/dx and dz/dy of the residual (H, W), mm per mm, by differences between pixels."""
        return differences(self.x, self.y, self.residual)

    @property
    def slope_rms(self) -> tuple[float, float]:
        """Rms of the residual's slopes along x and y, mm per mm (less noise: `slope_errors`)."""
        along_x, along_y = (float(np.sqrt(np.nanmean(s**2))) for s in self.slopes)
        return along_x, along_y

    def to_dict(self) -> dict[str, Any]:
        """Plain values, without the maps."""
        numbers = {"numbers": self.numbers.to_dict(), "held": self.held, "middle_mm": self.middle}
        rms, less = self.rms, self.rms_less_noise
        known = {"rms": (rms, *self.rms_sigmas(rms)), "rms_less_noise": (less, *self.rms_sigmas(less))}
        known |= {"pv": (self.pv, *self.pv_sigmas)}
        figures: dict[str, Any] = {"pvr_mm": self.pvr, "slope_rms": self.slope_rms}
        for name, (value, noise, rig) in known.items():
            figures |= {f"{name}_mm": value, f"{name}_sigma_mm": float(np.hypot(noise, rig))}
            figures |= {f"{name}_noise_mm": noise, f"{name}_rig_mm": rig}
        return {"form": self.form} | numbers | figures

    def deviation(self, height: HeightMap) -> HeightMap:
        """The map that was fitted, less the form: sigma by what the fit leaves of its noise (the map's where
        that of the slopes is unknown), and so the modes; NO_ANCHOR where no residual is known."""
        sigma = np.where(np.isfinite(self.noise), self.noise, height.sigma)
        unknown = np.where(np.isnan(self.residual) & height.good, int(HeightFlag.NO_ANCHOR), 0)
        flags = height.flags | unknown.astype(np.uint16)
        less = replace(height, z=self.residual, sigma=sigma, flags=flags, contacts=None)
        less = replace(less, references=(), shared=None)
        return less if self.modes is None else replace(less, modes=self.modes, modes_step=1)

    def export(self, path: str | Path, height: HeightMap) -> None:
        """Write the deviation of the map that was fitted, as `HeightMap.export` does; to an .npz also slope_x
        and slope_y."""
        pair = zip(("slope_x", "slope_y"), self.slopes, strict=True)
        slopes: dict[str, Any] = {name: each.astype(np.float32) for name, each in pair}
        self.deviation(height).export(path, **slopes)

    def grid(self, pitch_mm: float | None = None) -> Grid:
        """The residual on a regular grid of x and y (None: about as fine as the pixels)."""
        unknown = np.isnan(self.residual)
        nothing = np.zeros(unknown.shape)
        flags = np.where(unknown, int(HeightFlag.NO_ANCHOR), 0).astype(np.uint16)
        return HeightMap(self.x, self.y, self.residual, nothing, flags).resample(pitch_mm)


def fit_form(
    height: HeightMap,
    form: str = "sphere",
    slopes: SlopeMap | None = None,
    aperture: NDArray[np.bool_] | None = None,
) -> FormFit:
    """Unweighted least-squares fit of a form to the good pixels without their outermost ring.

    form: one of form_names(), followed by fixed parameters: 'sphere:radius=4000', 'conic:conic=-1'. slopes:
    slope map of the same correspondence, for sigmas by noise (None: by the noise that the map states).
    aperture (H, W): pixels to use. InputError without enough good pixels.
    """
    name, known, held = form_from_text(form)
    if len(held) == len(known.names):
        raise InputError(f"form {form!r}: every number is given, one must be left out to be fitted")
    x, y, good, middle = placed(height, len(known.names), aperture)
    z = height.z[good]
    p, free = _fitted(known, held, x[good], y[good], z)
    model = _freed(known, p, free)
    jacobian = _jacobian(model, p[free], x[good], y[good])
    covariances = covariances_of(jacobian, height, x, y, good, slopes)
    scale = np.abs(_statement(known, p)[free])
    sigmas = (scale * np.sqrt(np.diag(part)) for part in covariances)
    found = Numbers(tuple(known.names[i] for i in free), known.stated(p)[free], *sigmas)
    residual = np.full(height.z.shape, np.nan)
    residual[good] = z - known.model(p, x[good], y[good])
    left = leftovers(jacobian, residual, height, x, y, good, slopes)
    return FormFit(name, found, held, height.x, height.y, residual, middle, *left)


def leftovers(
    basis: Floats,
    residual: Floats,
    height: HeightMap,
    x: Floats,
    y: Floats,
    good: NDArray[np.bool_],
    slopes: SlopeMap | None,
) -> tuple[
    Floats, Floats, tuple[float, float], float, float, NDArray[np.float32] | None, Floats, SlopeNoise | None
]:  # fmt: skip
    """Fields of a FormFit with this residual (H, W), from noise to slope_noise.

    basis (n, k): the derivatives of the height by its free parameters."""
    noise, rig = (np.full(good.shape, np.nan) for _ in range(2))
    left, own, kept = residual[good], slope_noise(height, slopes), None
    step = trace = square = np.nan
    by_rig = 0.0
    if own is not None:
        found = residual_noise(basis, x, y, good, own)
        noise[good], step = found.sigma, found.step_variance
        square, trace = found.rms_variance(left - left.mean())
    rig[good] = 0.0
    q, _ = np.linalg.qr(np.column_stack([basis / np.linalg.norm(basis, axis=0), np.ones(len(left))]))
    if (modes := height.calibration) is not None:
        bent = np.nan_to_num(modes[:, good].astype(np.float64))
        bent -= (bent @ q) @ q.T
        rig[good] = np.sqrt(np.sum(bent**2, axis=0))
        by_rig = modes_variance(bent, left)
        kept = np.full((len(bent), *good.shape), np.nan, np.float32)
        kept[:, good] = bent
    return noise, rig, (square, by_rig), step, trace, kept, q, own


def placed(
    height: HeightMap, count: int, aperture: NDArray[np.bool_] | None = None, ring: bool = True
) -> tuple[Floats, Floats, NDArray[np.bool_], tuple[float, float]]:
    """x, y relative to the middle of the good pixels, good (H, W), and the middle. InputError without
    enough good pixels. aperture (H, W): pixels to use; ring: False where the map is without it already.

    The outermost ring of good pixels is left out: their centres may see no mirror. Where the map ends at the
    image's border, there is none, and none of a grid (FOREIGN), whose points lie on what was measured.
    """
    ring = ring and height.diagnostics.method != FOREIGN
    mirror = scipy.ndimage.binary_fill_holes(height.good)
    inside = scipy.ndimage.binary_erosion(mirror, np.ones((3, 3)), border_value=1) if ring else mirror
    good = height.good & inside & np.isfinite(height.z)
    good = good if aperture is None else good & aperture
    if np.count_nonzero(good) < 2 * count:
        few = f"{np.count_nonzero(good)} good pixels within the outermost ring"
        raise InputError(f"height map: {few}, must be at least {2 * count}; take a form of fewer numbers")
    middle = tuple(middle_of(part, good) for part in (height.x, height.y))
    x, y = (np.asarray(part, np.float64) - at for part, at in zip((height.x, height.y), middle, strict=True))
    return x, y, good, (middle[0], middle[1])


def slope_noise(height: HeightMap, slopes: SlopeMap | None) -> SlopeNoise | None:
    """Noise of the slope map, or the typical slope noise stored in the height map; None: unknown."""
    if slopes is not None:
        if slopes.x.shape != height.z.shape:
            raise InputError(f"slope map: {slopes.x.shape}, must be {height.z.shape} as the height map")
        for name in ("sigma_x", "sigma_y"):
            most = float(np.max(getattr(slopes, name)[slopes.good], initial=0.0))
            if most > _STEEPEST:
                raise InputError(
                    f"slope map: {name} is {most:g} in a good pixel, must be below {_STEEPEST:g}"
                )
        return SlopeNoise(np.nan_to_num(slopes.sigma_x), np.nan_to_num(slopes.sigma_y))
    usual = height.diagnostics.slope_sigma
    return SlopeNoise(*usual) if usual is not None else None


def covariances_of(
    jacobian: Floats,
    height: HeightMap,
    x: Floats,
    y: Floats,
    good: NDArray[np.bool_],
    slopes: SlopeMap | None,
) -> tuple[Floats, Floats]:
    """Covariances (m, m), by noise (NaN: unknown) and by the errors of the rig, of least-squares parameters
    with this Jacobian (n, m)."""
    size = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / size
    inverse = np.linalg.inv(unit.T @ unit)
    noise, count = slope_noise(height, slopes), len(size)
    by_noise = np.full((count, count), np.nan)
    if noise is not None:
        by_noise = inverse @ noise_covariance(unit, x, y, good, noise) @ inverse / np.outer(size, size)
        # a parameter that responds to a piston depends on the anchor: its sigma does not follow from slopes
        anchored = np.abs(inverse @ unit.sum(axis=0)) > _ANCHORED * np.abs(inverse) @ np.abs(unit).sum(axis=0)
        by_noise[anchored] = by_noise[:, anchored] = np.nan
    by_rig = np.zeros((count, count))
    if (modes := height.calibration) is not None:
        modes = np.nan_to_num(modes[:, good].astype(np.float64))
        answers = modes @ unit @ inverse / size
        by_rig = answers.T @ answers
    return by_noise, by_rig


def _quadric(x: Floats, y: Floats, z: Floats) -> Floats:
    """a, b, c, d, e, f of a + b x + c y + (d x^2 + 2 e x y + f y^2) / 2."""
    scale = max(float(np.abs(x).max()), float(np.abs(y).max()), 1e-12)
    u, v = x / scale, y / scale
    terms = np.stack([np.ones_like(u), u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=1)
    found = np.linalg.lstsq(terms, z, rcond=None)[0]
    return np.asarray(found / scale ** np.array([0, 1, 1, 2, 2, 2]))


def _fitted(form: Form, held: dict[str, float], x: Floats, y: Floats, z: Floats) -> tuple[Floats, list[int]]:
    """Internal parameters by Gauss-Newton steps from the best quadric (of several starts the one that leaves
    least), and the indices of the free ones."""
    free = [i for i, name in enumerate(form.names) if name not in held]
    found = list[tuple[float, int, Floats]]()
    for start in np.atleast_2d(form.start(_quadric(x, y, z))):
        given = form.stated(start)
        for name, value in held.items():
            given[form.names.index(name)] = value
        p = np.where([name in held for name in form.names], form.internal(given), start)
        if _settled(form, p, free, x, y, z):
            found.append((float(np.std(z - form.model(p, x, y))), len(found), p))
    if not found:
        raise InputError("form: the fit does not settle; give some of its numbers, or remove power")
    return min(found)[2], free


def _settled(form: Form, p: Floats, free: list[int], x: Floats, y: Floats, z: Floats) -> bool:
    """Gauss-Newton steps of p, in place; False where they diverge."""
    model = _freed(form, p, free)
    for _ in range(_STEPS):
        before = model(p[free], x, y)
        left = z - before
        jacobian = _jacobian(model, p[free], x, y)
        size = np.linalg.norm(jacobian, axis=0)
        if not (np.isfinite(left).all() and np.isfinite(size).all() and size.all()):
            return False
        p[free] += np.linalg.lstsq(jacobian / size, left, rcond=None)[0] / size
        moved = model(p[free], x, y) - before
        if np.sqrt(np.mean(moved**2)) <= _SETTLED * max(float(left.std()), 1e-9):
            break
    return bool(np.isfinite(model(p[free], x, y)).all())


def _freed(form: Form, p: Floats, free: list[int]) -> Callable[[Floats, Floats, Floats], Floats]:
    """The model as a function of the free parameters."""

    def model(values: Floats, x: Floats, y: Floats) -> Floats:
        whole = p.copy()
        whole[free] = values
        return form.model(whole, x, y)

    return model


def _jacobian(model: Callable[[Floats, Floats, Floats], Floats], p: Floats, x: Floats, y: Floats) -> Floats:
    """Jacobian (n, m) by central differences."""
    columns = []
    for i in range(len(p)):
        step = _NUDGE * max(abs(p[i]), 1e-3)
        ahead, behind = p.copy(), p.copy()
        ahead[i], behind[i] = p[i] + step, p[i] - step
        columns.append((model(ahead, x, y) - model(behind, x, y)) / (2 * step))
    return np.stack(columns, axis=1)


def _statement(form: Form, p: Floats) -> Floats:
    """Derivative of each stated parameter by its internal one (m,)."""
    step = _NUDGE * np.maximum(np.abs(p), 1e-12)
    return np.asarray((form.stated(p + step) - form.stated(p - step)) / (2 * step))


def differences(x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
    """dz/dx and dz/dy by central differences between pixels at x, y."""
    if min(z.shape) < 2:
        unknown = np.full(z.shape, np.nan)
        return unknown, unknown
    (zr, zc), (xr, xc), (yr, yc) = (np.gradient(np.asarray(part, np.float64)) for part in (z, x, y))
    with np.errstate(divide="ignore", invalid="ignore"):
        area = xc * yr - xr * yc
        return np.asarray((zc * yr - zr * yc) / area), np.asarray((zr * xc - zc * xr) / area)
