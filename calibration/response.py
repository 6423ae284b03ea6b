"""Radiometric response of a rig: display response, blur, vignetting and backlight, stored in `[response]`.

A pixel p records a uniform frame of level l as I = dark + gain(p) (black + g(l)), independent of blur: a ramp
determines g and black. The modulation of a fringe of period P is that of its light after g, times the MTF

    sinc(1 / P) sinc(w / P) exp(-2 pi^2 b^2 / P^2)

of a cell, of the pixel's footprint w (known from the map) and of a Gaussian blur of b cells: fringes
determine b. The gain is vignetting(p) times backlight(u, v). Captures in which different pixels view one
place of the pattern separate the two, as polynomials of their logarithms with one common mean; one capture
determines only their product.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from optolever.arrays import Floats
from optolever.decode import Correspondence, Response, decode
from optolever.errors import InputError
from optolever.files import save_arrays, together
from optolever.notices import Notice
from optolever.patterns import Frame
from optolever.projector import Capture
from optolever.scene import rig_table, write_sections
from optolever.schema import load_record

__all__ = ["RigResponse", "load_response", "measure_response", "store_response", "with_better_fit"]

#: Degree of the polynomials of log gain: they fit log(1 - t), t up to a half, to 0.3 %.
_DEGREE = 6
#: Parts of a capture, whose scatter is the blur's error; approximate number of pixels in the fit of log gain.
_PARTS, _MOST = 16, 20000
#: Relative error of the modulation by rounding to 8 bits: 1 / (255 sqrt 12).
_ROUNDED = 1.1e-3
#: Relative standard deviation of vignetting and backlight above which they are not separated.
_PARTED = 0.02
#: Margin in pixels and cells at a border, where footprint or blur may lose light.
_BORDER = 4
#: Share of the brightest gain below which a pixel views no display; typical light of black (200:1).
_LIT, _CONTRAST = 0.25, 0.005
#: Ratio of sigma with a response to sigma without it, above which the response is doubtful; rms of a normal
#: variable over its median magnitude.
_WIDER, _RMS = 3.0, 1.4826


def with_better_fit(found: Correspondence, plain: Correspondence) -> Correspondence:
    """The decoding with a response, `found`, checked by the decoding of the same frames without it, `plain`.

    If sigma of `plain` is clearly smaller (median ratio above 3): its sigma, with the typical difference of
    both coordinates added in quadrature, and a notice.
    """
    both, sigma, worst = found.good & plain.good, {}, 0.0
    if not both.any():
        return found
    for axis in ("u", "v"):
        wide, narrow = (getattr(one, f"sigma_{axis}") for one in (found, plain))
        if np.isfinite(wide[both]).any():
            worst = max(worst, float(np.median(wide[both] / narrow[both])))
            apart = _RMS * float(np.median(np.abs(getattr(found, axis) - getattr(plain, axis))[both]))
            sigma[f"sigma_{axis}"] = np.fmin(wide, np.hypot(narrow, np.float32(apart)))
    if worst <= _WIDER:
        return found
    notice = Notice(
        "The frames fit better without the stated response; sigma with it over sigma without",
        worst,
        _WIDER,
        "sigma is that without it, plus the difference; most likely the exposure has changed since: measure "
        "it again (optolever response), or leave out decode --response",
    )
    return replace(found, **sigma, notices=(*found.notices, notice))


@dataclass(frozen=True, slots=True, eq=False)
class RigResponse:
    """response: light of the levels, with the blur; black: light of level 0 relative to (white less black).

    gain (H, W): white less black in the ramp, camera levels; the product of vignetting and backlight.
    vignetting (H, W), backlight (rows, cols): relative to their maxima; NaN outside the captures, None: not
    separated. blur_sigma, parted_sigma: standard deviation of the blur (cells) and of the two (relative).
    """

    response: Response
    black: float
    gain: Floats
    blur_sigma: float = float("nan")
    vignetting: Floats | None = None
    backlight: Floats | None = None
    parted_sigma: float = float("nan")

    @property
    def gamma(self) -> tuple[float, float]:
        """Exponent of the power law fitted to the light of the levels, and its rms residual as a share of
        white."""
        level, light = np.arange(1, 256) / 255, self.response.light()[1:]
        found = scipy.optimize.least_squares(lambda gamma: level**gamma - light, 1.0)
        return float(found.x[0]), float(np.sqrt(np.mean(found.fun**2)))

    def least(self) -> dict[str, float | None]:
        """Least over largest value of gain, vignetting and backlight; None: not separated."""
        maps = {"gain": self.gain, "vignetting": self.vignetting, "backlight": self.backlight}
        return {
            name: None if each is None else float(np.nanmin(each) / np.nanmax(each))
            for name, each in maps.items()
        }


def measure_response(
    ramp: Capture, captures: Sequence[Capture] = (), names: Sequence[str] = ()
) -> RigResponse:
    """Response and gain from a ramp; blur from captures of fringes with the same camera and display; with
    two or more different poses of the mirror also vignetting and backlight. names: of ramp and captures, for
    errors."""
    with _named(names, 0):
        found, camera = _levels(ramp)
    views = []
    for number, capture in enumerate(captures, 1):
        with _named(names, number):
            views.append(_view(found, camera, capture))
    told = np.array([part for view in views for part in view.squares])
    if len(told):
        square, variance, rounded = told.T
        weight = 1 / (variance + rounded)
        square, error = weight @ square / weight.sum(), (1 / weight.sum() + rounded.min()) ** 0.5
        blur = float(max(square, 0.0) ** 0.5)
        sigma = float(error / (2 * max(blur, (error / 2) ** 0.5)))
        found = replace(found, response=replace(found.response, blur=blur), blur_sigma=sigma)
    return _parted(found, views)


@contextmanager
def _named(names: Sequence[str], number: int) -> Iterator[None]:
    """Prefix an InputError with the capture's name."""
    try:
        yield
    except InputError as error:
        name = names[number] if number < len(names) else f"capture {number}" if number else "ramp"
        raise InputError(f"{name}: {error}") from error


def _levels(ramp: Capture) -> tuple[RigResponse, float]:
    """Light of the levels, and the camera's dark level."""
    response = Response.from_ramp(ramp.frames, ramp.sequence)
    shown = [_shown(frame) for frame in ramp.sequence.frames]
    order = sorted((i for i, level in enumerate(shown) if level is not None), key=lambda i: shown[i] or 0)
    frames = ramp.frames[order].astype(np.float64)
    gain = frames[-1] - frames[0]
    lit = (gain > _LIT * np.percentile(gain, 95)) & (frames[-1] < ramp.white)
    others = float(np.mean([response.light()[shown[i] or 0] for i in order[1:]]))
    black, camera = _dark(frames[0][lit], frames[1:].mean(axis=0)[lit], others)
    return RigResponse(response, black, np.where(lit, gain, np.nan)), camera


def _dark(dark: Floats, bright: Floats, light: float) -> tuple[float, float]:
    """Light of level 0, and the camera's dark level, by regression over the pixels: the dark frame is
    camera + black gain, the mean of the other frames is camera + (black + light) gain. Without variation of
    the gain, black tends to 0."""
    away = bright - bright.mean()
    share = float(away @ dark / (away @ away + dark.var() / _CONTRAST**2))
    share = min(max(share, 0.0), 0.5)
    return share * light / (1 - share), float(dark.mean() - share * bright.mean()) / (1 - share)


def _shown(frame: Frame) -> int | None:
    """Level of a uniform frame; None for other frames."""
    return {"white": 255, "black": 0, "uniform": frame.level}.get(frame.kind)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A capture: gain (H, W), correspondence, usable pixels (H, W), rows and cols of the display; squares:
    per fringe the squared blur (cells^2), its variance, and its variance by rounded levels."""

    gain: Floats
    where: Correspondence
    good: NDArray[np.bool_]
    surface: tuple[int, int]
    squares: list[tuple[float, float, float]]


def _view(found: RigResponse, camera: float, capture: Capture) -> _View:
    if capture.shape != found.gain.shape:
        raise InputError(f"response: capture has {capture.shape} pixels, the ramp {found.gain.shape}")
    where = decode(capture.frames, capture.sequence, response=found.response)
    good = where.good & (capture.frames < capture.white).all(axis=0)
    for at, extent in ((where.u, capture.sequence.cols), (where.v, capture.sequence.rows)):
        good &= np.abs(at - 0.5 * (extent - 1)) < 0.5 * extent - _BORDER
    good = binary_erosion(good, iterations=_BORDER)
    if not good.any():
        raise InputError("response: no pixel of the capture is good and below its white level")
    light = capture.frames - camera
    level, curve = np.arange(256), found.black + found.response.light()
    cosine = np.cos(np.linspace(0, 2 * np.pi, 1024, endpoint=False))
    first = 2 * np.mean(np.interp(127.5 + 127.5 * cosine, level, curve) * cosine)
    gains, squares = [], []
    for axis, period, index, shifts in _fringes(capture):
        coordinate = getattr(where, axis)
        phase = 2 * np.pi * coordinate / period - shifts[:, None, None]
        # relative to the light at this phase: harmonics do not average out over only 3 or 4 steps
        gains.append(
            light[index].sum(axis=0) / np.interp(127.5 + 127.5 * np.cos(phase), level, curve).sum(axis=0)
        )
        wave = 2 * np.mean(light[index] * np.cos(phase), axis=0)
        footprint = [np.sinc(part / period) for part in np.gradient(coordinate)]
        modulation = gains[-1] * first * np.sinc(1 / period) * footprint[0] * footprint[1]
        used = good & np.isfinite(modulation)
        if np.count_nonzero(used) >= _PARTS:
            starts = np.linspace(0, np.count_nonzero(used), _PARTS, endpoint=False).astype(int)
            own, full = (np.add.reduceat(one[used], starts) for one in (wave, modulation))
            unit = period**2 / (2 * np.pi**2)
            parts = -unit * np.log(np.maximum(own, 1e-9) / full)
            squares.append((float(parts.mean()), float(parts.var() / (_PARTS - 1)), (_ROUNDED * unit) ** 2))
    if not gains:
        raise InputError("response: the capture shows no fringes of three or more equal shifts")
    gain = np.mean(gains, axis=0)
    with np.errstate(invalid="ignore"):
        good &= gain > 0
    return _View(gain, where, good, (capture.sequence.rows, capture.sequence.cols), squares)


def _fringes(capture: Capture) -> list[tuple[str, float, list[int], Floats]]:
    """Fringes of three or more equal shifts: axis, period, frame indices and shifts."""
    groups: dict[tuple[str, float], list[int]] = {}
    for i, frame in enumerate(capture.sequence.frames):
        if frame.kind == "phase":
            groups.setdefault((frame.axis or "", frame.period_px or 1.0), []).append(i)
    found = []
    for (axis, period), index in groups.items():
        frames = [capture.sequence.frames[i] for i in index]
        shifts = np.array([(frame.shift or 0.0) + np.pi * frame.inverted for frame in frames])
        order = np.sort(shifts % (2 * np.pi))
        if len(index) >= 3 and np.ptp(np.diff(order, append=order[0] + 2 * np.pi)) < 1e-3:
            found.append((axis, period, index, shifts))
    return found


def _powers(down: Floats, along: Floats) -> Floats:
    """Monomials (K, terms) at coordinates in -1..1, without the constant."""
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i) if i + j]
    return np.stack([down**i * along**j for i, j in powers], axis=1)


def _scaled(at: Any, extent: int) -> Floats:
    return np.asarray(2 * np.asarray(at, np.float64) / max(extent - 1, 1) - 1)


def _parted(found: RigResponse, views: list[_View]) -> RigResponse:
    """The response with vignetting and backlight, if the captures separate them."""
    if len(views) < 2:
        return found
    (rows, cols), (height, width) = views[0].surface, found.gain.shape
    if any(view.surface != (rows, cols) for view in views):
        raise InputError("response: captures were shown on surfaces of different sizes")
    lens, screen, gains = [], [], []
    for view in views:
        place = np.argwhere(view.good)
        row, col = place[:: max(1, len(place) // _MOST)].T
        lens.append(_powers(_scaled(row, height), _scaled(col, width)))
        screen.append(_powers(_scaled(view.where.v[row, col], rows), _scaled(view.where.u[row, col], cols)))
        gains.append(view.gain[row, col])
    gain = np.concatenate(gains)
    columns = np.hstack([np.concatenate(lens), np.concatenate(screen), np.ones((len(gain), 1))])
    # noise of log(level) is noise of the level over the level
    left, values, right = np.linalg.svd(columns * gain[:, None], full_matrices=False)
    used = values > 1e-12 * values[0]
    inverse = right[used].T / values[used]
    solved = inverse @ (left[:, used].T @ (np.log(gain) * gain))
    noise = np.std((np.log(gain) - columns @ solved) * gain)
    half = columns.shape[1] // 2
    errors = [
        noise
        * np.sqrt(np.square((columns[:, own] - columns[:, own].mean(axis=0)) @ inverse[own]).sum(axis=1))
        for own in (slice(half), slice(half, -1))
    ]
    sigma = float(max(np.percentile(error, 95) for error in errors))
    if not sigma < _PARTED:
        return replace(found, parted_sigma=sigma)
    image, surface = np.isfinite(found.gain), np.zeros((rows, cols), np.uint8)
    for view in views:
        places = np.stack([view.where.u[view.good], view.where.v[view.good]], axis=1)
        cv2.fillConvexPoly(surface, cv2.convexHull(np.rint(places).astype(np.int32)), 1)
    maps = [_share(mask, solved[own]) for mask, own in ((image, slice(half)), (surface > 0, slice(half, -1)))]
    return replace(found, vignetting=maps[0], backlight=maps[1], parted_sigma=sigma)


def _share(mask: NDArray[np.bool_], terms: Floats) -> Floats:
    """exp of a polynomial over its largest value in the mask; NaN outside."""
    row, col = np.nonzero(mask)
    out = np.full(mask.shape, np.nan)
    power = _powers(_scaled(row, mask.shape[0]), _scaled(col, mask.shape[1])) @ terms
    out[mask] = np.exp(power - power.max())
    return out


def store_response(rig: str | Path, found: RigResponse) -> Path:
    """Write the response into the folder of the rig's TOML, and its name into the TOML; the .npz's path."""
    beside = Path(rig).with_suffix(".response.npz")
    gamma, misfit = found.gamma
    section = {"file": beside.name, "gamma": gamma, "misfit": misfit}
    if found.response.blur is not None and math.isfinite(found.response.blur):
        section["blur_px"] = found.response.blur
    maps = {name: getattr(found, name) for name in ("gain", "vignetting", "backlight")}
    numbers = {name: getattr(found, name) for name in ("black", "blur_sigma", "parted_sigma")}
    curve = {name: getattr(found.response, name) for name in ("shown", "seen", "blur")}
    with together():
        save_arrays(beside, curve | numbers | maps)
        write_sections(rig, {"response": section})
    return beside


@dataclass(frozen=True, slots=True, eq=False)
class _Stored:
    """RigResponse in its file."""

    shown: Annotated[Floats, "K"]
    seen: Annotated[Floats, "K"]
    blur: float
    black: float
    gain: Annotated[Floats, "H W"]
    blur_sigma: float
    parted_sigma: float
    vignetting: Annotated[Floats, "H W"] | None = None
    backlight: Annotated[Floats, "rows cols"] | None = None


def load_response(rig: str | Path) -> RigResponse:
    """The response that a rig's TOML names in [response]. InputError names the wrong file."""
    file = Path(rig)
    section = rig_table(file).get("response")
    name = section.get("file") if isinstance(section, Mapping) else None
    if not isinstance(name, str):
        raise InputError(f"{file}: [response] must name a file; run `optolever response`")
    beside = file.parent / name
    found = load_record(_Stored, beside)
    try:
        response = Response(found.shown, found.seen, found.blur)
    except InputError as error:
        raise InputError(f"{beside}: {error}") from error
    names = [field.name for field in fields(RigResponse)[1:]]
    return RigResponse(response, **{name: getattr(found, name) for name in names})
