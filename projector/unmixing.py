"""Pictures in colour, each of three frames: unmixed into the frames that a grey camera would have taken.

A camera of linear levels sees dark_i + sum_j mix_ij light_j, light_j the light of the frame that channel j of
the display shows, 0 to 1. Its inverse gives the lights; their noise, crosstalk included, is what `decode`
estimates from the frames. Frames are in light: the display's curve stays in them.

A mosaic is read as quads, pixels of half the resolution: demosaicked pictures have colours that are none at
2 x 2 pixels each. The planes of red and blue lie a quarter of a quad beside the quad's centre, and are moved
there by a polynomial of twelve places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import STRIPES, Frame, Sequence
from optolever.scene import MOSAICS
from optolever.schema import require_shapes

from .capture import Capture

__all__ = ["ColourResponse", "centred_harmonics", "quads", "unmixed"]

Floats = NDArray[np.float64]
Images = NDArray[np.uint8] | NDArray[np.uint16]
#: Level of no light and levels of the light 1, with room for noise below and above; a saturated sample.
_BASE, _SPAN, _TOP = 4096, 49152, 65535
#: Places to each side by which a plane is moved.
_TAPS = 6
#: By how much the noise of pixels of odd and even rows and columns may differ; times the root of their
#: number, six deviations; least noise per step that is no rounding, levels^2.
_UNEVEN, _SURE, _ROUNDED = 0.15, 15.0, 6.0
#: Largest condition of a mix: unmixing then multiplies noise by it.
_WORST = 30


@dataclass(frozen=True, slots=True, eq=False)
class ColourResponse:
    """Camera and display in colour, in shares of the camera's white level: dark (3,), mix (3, 3) of camera by
    display, the standard deviations mix_sigma (3, 3), misfit (rms of the pictures it was measured from).
    levels (K,) of the display and their light (3, K) of each channel, 0 to 1; mosaic: one of MOSAICS, of raw
    pictures, None: three values in every pixel; stripes: order of the display's, None: not measured."""

    dark: Annotated[Floats, "3"]
    mix: Annotated[Floats, "3 3"]
    mix_sigma: Annotated[Floats, "3 3"]
    misfit: float
    levels: Annotated[Floats, "K"]
    light: Annotated[Floats, "3 K"]
    mosaic: str | None = None
    stripes: str | None = None

    def __post_init__(self) -> None:
        require_shapes(self)
        if not np.linalg.cond(self.mix) < _WORST:
            cure = "measure it again: optolever response --colour"
            raise InputError(f"colour: mix is {self.mix.tolist()}, its rows nearly agree; {cure}")
        if self.mosaic not in (None, *MOSAICS):
            raise InputError(f"colour: mosaic is {self.mosaic!r}, must be one of {', '.join(MOSAICS)}")
        if self.stripes not in (None, *STRIPES):
            raise InputError(f"colour: stripes is {self.stripes!r}, must be one of {', '.join(STRIPES)}")

    @property
    def leak(self) -> float:
        """Standard deviation of a channel's share that remains in another, of its white."""
        return float(np.sqrt(np.mean(self.mix_sigma**2)) / self.mix.sum(axis=1).mean())


def unmixed(
    images: Images,
    sequence: Sequence,
    response: ColourResponse,
    *,
    bits: int = 8,
) -> Capture:
    """Frames (N, H, W) of a sequence in colour, as of a linear grey camera of 16 bits, from the images (E, H,
    W, 3) of its E exposures.

    Where the response is of a mosaic, images are (E, 2 H, 2 W), or (E, 2 H, 2 W, 3) made of one. A sample at
    the white level costs the three frames of its exposure, there. InputError if images do not fit.
    """
    packing, mosaic = sequence.packing, response.mosaic
    if packing is None:
        raise InputError("colour: the sequence is in grey; patterns.packed puts three frames in an exposure")
    known = {response.stripes, packing.stripes} - {None, "unknown"}
    if len(known) > 1 and any(frame.axis == "u" for frame in sequence.frames):
        wrong = f"drawn for stripes {packing.stripes}, the display has {response.stripes}"
        cure = f"show --colour {response.stripes}, or measure again: optolever response --colour"
        raise InputError(f"colour: patterns are {wrong}; {cure}")
    planes_of = _checked(images, len(packing.exposures), mosaic)
    white, back = float(2**bits - 1), np.linalg.inv(response.mix)
    often = np.bincount(np.ravel(packing.exposures))
    rows, cols = (size // (2 if mosaic else 1) for size in images.shape[1:3])
    total = np.zeros((len(often), rows, cols), np.float32)
    lost = np.zeros(total.shape, np.bool_)
    for own, image in zip(packing.exposures, images, strict=True):
        seen = planes_of(image)
        full = (seen >= white).any(axis=-1)
        light = seen / white - response.dark
        if mosaic is not None:
            light = np.stack([moved(light[..., c], at) for c, at in enumerate(sites(mosaic))], axis=-1)
            full = scipy.ndimage.maximum_filter(full, 2 * _TAPS - 1)
        light = light @ back.T
        for channel, i in enumerate(own):
            total[i] += light[..., channel] / often[i]
            lost[i] |= full
    if mosaic is None:
        _require_planes(total, sequence, white)
    levels = np.clip(np.rint(_BASE + _SPAN * total), 0, _TOP - 1)
    frames = np.where(lost, _TOP, levels).astype(np.uint16)
    packing = replace(packing, leak=response.leak, wider=1.0 if mosaic is None else _wider(mosaic))
    return Capture(frames, centred_harmonics(replace(sequence, packing=packing)), bits=16)


def _checked(images: Images, exposures: int, mosaic: str | None) -> Any:
    """How an image becomes planes (H, W, 3)."""
    shape = images.shape
    if len(images) != exposures:
        raise InputError(f"colour: {len(images)} pictures, the sequence has {exposures} exposures")
    if mosaic is None:
        if images.ndim != 4 or shape[-1] != 3:
            cure = "of a mosaic measure it with optolever response --mosaic"
            raise InputError(f"colour: pictures have shape {shape[1:]}, must be (H, W, 3); {cure}")
        return np.asarray
    if images.ndim not in (3, 4) or shape[1] % 2 or shape[2] % 2:
        raise InputError(f"colour: pictures have shape {shape[1:]}, a mosaic has even rows and columns")
    return lambda image: quads(image, mosaic)


def quads(raw: NDArray[Any], mosaic: str) -> Floats:
    """Planes (H, W, 3) of a mosaic (2 H, 2 W), or of a picture (2 H, 2 W, 3) made of one, of which each
    pixel's measured colour is taken."""
    found = []
    for channel, colour in enumerate("RGB"):
        plane = raw if raw.ndim == 2 else raw[..., channel]
        own = [plane[k // 2 :: 2, k % 2 :: 2].astype(np.float64) for k in range(4) if mosaic[k] == colour]
        found.append(sum(own) / len(own))
    return np.stack(found, axis=-1)


def _require_planes(light: NDArray[np.float32], sequence: Sequence, white: float) -> None:
    """InputError where neighbouring pixels differ in noise as a mosaic's do: by what four or more steps of a
    fringe, of an even number, leave when those of opposite phase are subtracted."""
    fringes: dict[tuple[str | None, float | None], list[int]] = {}
    for i, frame in enumerate(sequence.frames):
        if frame.kind == "phase":
            fringes.setdefault((frame.axis, frame.period_px), []).append(i)
    for index in fringes.values():
        by = sorted(index, key=lambda i: sequence.frames[i].shift or 0.0)
        steps = np.diff([sequence.frames[i].shift or 0.0 for i in by])
        if len(by) < 4 or len(by) % 2 or np.ptp(steps) > 1e-6 or abs(steps[0] * len(by) - 2 * np.pi) > 1e-6:
            continue
        rest = white * (
            light[by[::2]].sum(axis=0, dtype=np.float64) - light[by[1::2]].sum(axis=0, dtype=np.float64)
        )
        # across both directions, where fringes that flicker or lag leave nothing
        bend = np.square(_second(_second(rest).T))
        if bend.mean() < _ROUNDED * len(by):
            continue
        own = [float(bend[y::2, x::2].mean()) for y in (0, 1) for x in (0, 1)]
        ratio, most = max(own) / max(min(own), 1e-9), 1 + max(_UNEVEN, _SURE * (bend.size / 4) ** -0.5)
        if ratio > most:
            cure = "take raw pictures and measure with optolever response --mosaic, or show grey patterns"
            found = f"noise of neighbouring pixels differs by {ratio:.3g}, at most {most:.3g}"
            raise InputError(f"colour: pictures are demosaicked ({found}); {cure}")


def _second(of: Floats) -> Floats:
    return np.asarray(of[:, :-2] - 2 * of[:, 1:-1] + of[:, 2:])


def sites(mosaic: str) -> list[tuple[float, float]]:
    """Down and right, quads: from each plane's samples to the quad's centre."""
    places = [[(k // 2, k % 2) for k in range(4) if mosaic[k] == colour] for colour in "RGB"]
    return [(0.25 - 0.5 * y, 0.25 - 0.5 * x) for y, x in (np.mean(own, axis=0) for own in places)]


def moved(plane: Floats, by: tuple[float, float]) -> Floats:
    """Values at + by of a plane (H, W), by Lagrange's polynomial of 2 _TAPS places along each axis: of
    fringes of 7 pixels to 0.00001. Beyond the border the plane continues odd: an even continuation shifts the
    places at the mirror's edge, and tilts its height."""
    plane = np.pad(plane, _TAPS, mode="reflect", reflect_type="odd")
    for axis, shift in enumerate(by):
        if shift:
            at, taps = _taps(shift)
            plane = scipy.ndimage.correlate1d(plane, taps, axis, mode="mirror", origin=-int(at[_TAPS]))
    return plane[_TAPS:-_TAPS, _TAPS:-_TAPS]


def _taps(shift: float) -> tuple[NDArray[np.int64], Floats]:
    """Places (2 _TAPS,) and weights of a value `shift` beside 0."""
    at = np.sort(np.sign(shift) * np.arange(1 - _TAPS, _TAPS + 1)).astype(np.int64)
    return at, np.array([np.prod([(shift - b) / (a - b) for b in at if b != a]) for a in at])


def _wider(mosaic: str) -> float:
    """Factor on sigma, 1.15: heights sum the slow part of the noise, which moving a plane keeps, while
    places show all of it, of which three quarters are kept."""
    gains = [np.prod([float(np.square(_taps(s)[1]).sum()) for s in site if s]) for site in sites(mosaic)]
    return float(1 / np.sqrt(min(gains)))


def centred_harmonics(sequence: Sequence) -> Sequence:
    """Fringes along u with the shift that their displayed levels have, on the mean of a fringe's steps.

    Four steps of a period of eight cells show the same eight levels again and again; where they are drawn for
    stripes a third of a cell aside, rounding them to 8 bits moves the fringe by 0.0016 cells.
    """
    packing = sequence.packing
    if packing is None or packing.stripes == "none":
        return sequence
    off: dict[float, list[float]] = {}
    for channel in range(3):
        for frame in sequence.channel(channel).frames:
            if (frame.kind, frame.axis) == ("phase", "u"):
                off.setdefault(frame.period_px or 1.0, []).append(_rounded_by(frame, sequence))
    if min(map(len, off.values()), default=0) < 3:
        return sequence  # a look-up goes by displayed levels
    more = {period: float(np.mean(shifts)) for period, shifts in off.items()}
    frames = tuple(
        replace(frame, shift=(frame.shift or 0.0) + more[frame.period_px or 1.0])
        if (frame.kind, frame.axis) == ("phase", "u")
        else frame
        for frame in sequence.frames
    )
    return replace(sequence, frames=frames)


def _rounded_by(frame: Frame, surface: Sequence) -> float:
    """Radians by which the shift of a fringe's displayed levels along u exceeds its own, by least squares."""
    levels = frame.tables(surface.rows, surface.cols)[0]
    angle = 2 * np.pi * np.arange(len(levels)) / (frame.period_px or 1.0) - (frame.shift or 0.0)
    waves = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    _, c, s = np.linalg.lstsq(waves, levels.astype(np.float64), rcond=None)[0]
    return float(np.arctan2(s, c))
