"""Swept stripes and codes without fringes as the decoder itself reads them: in images of the view, in many
draws of noise.

What a window leaves out, what stands at the border, what few stripes tell of the noise, which bits blur and
noise turn over, which pixels their neighbours accuse: none of this has a closed form that is worth having.
Some small images cost some milliseconds.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from optolever.decode import Correspondence, decode
from optolever.patterns import Frame, Sequence
from optolever.projector import NOMINAL_SENSOR

from .codes import cell_error, code_of
from .free_codes import FAR, PER_CELL, at_places, seen_profiles
from .records import AxisPrediction, Steps
from .view import Floats, Levels, View

__all__ = ["is_read", "read_axes"]

#: Entries of a table per cell, for codes, which change within one; entries over which sweeps are smoothed.
CODE_PER_CELL, SMOOTH = 16, PER_CELL
#: Pixels that are read, about; images at most.
PIXELS, IMAGES = 400_000, 32
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class _Reading:
    """Of pixels (K,): place and decoded coordinate (cells), its stated sigma, whether it is unflagged; entry
    (K,) of the table of places that it belongs to, and their number. refused: per pixel of the view (H, W),
    probability that it is flagged for what an axis does; flagged (D, H, W): whether it is, in every image."""

    place: Floats
    coord: Floats
    sigma: Floats
    good: Mask
    entry: NDArray[np.int64]
    entries: int
    refused: Floats
    flagged: NDArray[np.bool_]

    def mean(self, values: Floats | Mask, where: Mask) -> Floats:
        """Of what was read at each place (entries,); between places where nothing was: from those around."""
        count = np.bincount(self.entry[where], minlength=self.entries)
        known = np.flatnonzero(count)
        if known.size == 0:
            return np.zeros(self.entries)
        total = np.bincount(self.entry[where], values[where], self.entries)
        return np.interp(np.arange(self.entries), known, total[known] / count[known])


def is_read(frames: list[Frame]) -> bool:
    """Whether frames of an axis are what is read here."""
    return not any(frame.kind == "phase" for frame in frames) and (
        bool(code_of(frames)) or any(frame.kind == "stripe" for frame in frames)
    )


def read_axes(view: View, sequence: Sequence, levels: Levels) -> dict[str, AxisPrediction]:
    """The axes of a sequence that are swept, or shown in bits alone, read by pixels of the usual footprint in
    the usual light."""
    frames = {axis: [frame for frame in sequence.frames if frame.axis == axis] for axis in "uv"}
    axes = [axis for axis in "uv" if is_read(frames[axis])]
    per_cell = {axis: CODE_PER_CELL if code_of(frames[axis]) else PER_CELL for axis in axes}
    read = _read(view, sequence, levels, per_cell)
    return {
        axis: _of_code(view, axis, frames[axis], read[axis])
        if code_of(frames[axis])
        else _of_sweep(view, axis, levels, read[axis])
        for axis in axes
    }


def _of_sweep(view: View, axis: str, levels: Levels, read: _Reading) -> AxisPrediction:
    """Stripes; noise grows with what light a pixel lacks."""
    error = read.coord - read.place
    near = read.good & (np.abs(error) < FAR)
    bias = read.mean(error, near)
    square = read.mean((error - bias[read.entry]) ** 2, near)
    here, visible = view.coordinate(axis), view.visible
    own = np.sqrt(levels.variance(levels.half)) / np.maximum(levels.half, 1e-9)
    own = np.where(visible, own / np.median(own[visible]), 1.0)
    return AxisPrediction(
        own * at_places(here, np.sqrt(_smooth(square))),
        at_places(here, _smooth(bias)),
        at_places(here, read.mean(~near, read.good)),
        read.refused,
        own * at_places(here, read.mean(read.sigma, near)),
        flagged=read.flagged,
    )


def _of_code(view: View, axis: str, frames: list[Frame], read: _Reading) -> AxisPrediction:
    """Bits: what noise does is to lead into a neighbouring cell."""
    code = code_of(frames)[0]
    pitch, error = code.cell_px, read.coord - read.place
    cells = np.rint((error - cell_error(read.place, code)) / pitch)
    near = read.good & (np.abs(cells) <= 1)
    mean = read.mean(error, near)
    square = read.mean((error - mean[read.entry]) ** 2, near)
    here = view.coordinate(axis)
    # means and variances change steadily from cell to cell, probabilities do not
    tables = (
        *(mean, square, read.mean(np.abs(cells) > 1, read.good)),
        *(read.mean(read.sigma, near & (cells == 0)), read.mean(read.sigma, near & (cells != 0))),
    )
    mean, square, astray, stated, of_step = (at_places(here, table, CODE_PER_CELL) for table in tables)
    moved = (mean - cell_error(here, code)) / pitch
    both = square / pitch**2 + moved**2
    up, down = (np.clip(0.5 * (both + way * moved), 0.0, 1.0) for way in (1, -1))
    moved = pitch * (up - down)
    noise = np.sqrt(np.maximum(pitch**2 * (up + down) - moved**2, 0.0))
    steps = Steps(up, down, pitch, np.where(of_step > 0, of_step, stated))
    bias = cell_error(here, code) + moved
    return AxisPrediction(noise, bias, astray, read.refused, stated, steps, read.flagged)


def _read(view: View, sequence: Sequence, levels: Levels, per_cell: dict[str, int]) -> dict[str, _Reading]:
    """Images of those axes, with the references of the sequence, decoded: neighbours tell of each other what
    they do in a capture. per_cell: entries of an axis's table."""
    frames = tuple(f for f in sequence.frames if f.axis in per_cell or f.kind in ("white", "black"))
    shown = Sequence(frames, sequence.rows, sequence.cols)
    places = {axis: _places(view, axis) for axis in "uv"}
    seen = np.isfinite(places["u"]) & np.isfinite(places["v"])
    half = float(np.median(levels.half[view.visible]))
    light = levels.dark + 2 * half * _light(view, shown, places)
    found = list(_decoded(view, shown, levels, light, len(shown) < len(sequence)))
    flagged = np.stack([~f.good for f in found])
    # of both axes together, as neighbours are accused; nobody needs to know of which
    refused = 1 - (1 - _of_view(view, flagged.mean(axis=0))) ** (1 / len(per_cell))
    some = np.stack([_some(view, one) for one in flagged])
    read = {}
    for axis, fine in per_cell.items():
        coord, sigma, good = (
            np.concatenate([getattr(one, name)[seen] for one in found])
            for name in (axis, f"sigma_{axis}", "good")
        )
        at, entries = np.tile(places[axis][seen], len(found)), fine * view.extent(axis)
        entry = np.floor((at + 0.5) * fine).astype(np.int64).clip(0, entries - 1)
        read[axis] = _Reading(at, coord, sigma, good & np.isfinite(coord), entry, entries, refused, some)
    return read


def _light(view: View, shown: Sequence, places: dict[str, Floats]) -> Floats:
    """Share of full light (N, H, W) that pixels of the usual footprint read at their places; 0 at none."""
    images = np.ones((len(shown), *places["u"].shape))
    for axis, place in places.items():
        width = float(np.nanmedian(np.hypot(*view.widths[axis])))
        profiles = seen_profiles(shown, axis, width, view.scene.pattern.blur_px, CODE_PER_CELL)
        kept: dict[bytes, Floats] = {}
        for image, profile in zip(images, profiles, strict=True):
            key = profile.tobytes()
            if key not in kept:
                kept[key] = at_places(place, profile, CODE_PER_CELL)
            image *= kept[key]
    return np.where(np.isfinite(places["u"]) & np.isfinite(places["v"]), images, 0.0)


def _decoded(
    view: View, shown: Sequence, levels: Levels, light: Floats, told: bool
) -> Iterator[Correspondence]:
    """Images of that light, in draws of noise; told: the decoder knows the noise, as frames of an axis that
    is not shown here tell it."""
    bits = (view.scene.sensor or NOMINAL_SENSOR).bits
    top, kind = 2**bits - 1, np.uint8 if bits <= 8 else np.uint16
    step = 255 / top
    spread = np.sqrt(np.maximum(levels.variance(light - levels.dark) - step**2 / 12, 0.0))
    mean, scatter = (np.asarray(part / step, np.float32) for part in (light, spread))
    noise = np.sqrt(max(levels.read2 / step**2 - 1 / 12, 0.0)) if told else None
    gain, rng = levels.shot / step if told else 0.0, np.random.default_rng(0)
    for _ in range(int(np.clip(PIXELS / mean[0].size, 2, IMAGES)) // 2):
        drawn = scatter * rng.standard_normal(mean.shape, np.float32)
        for way in (1, -1):  # what is odd in the noise leaves the means
            raw = np.rint(mean + way * drawn).clip(0, top).astype(kind)
            yield decode(raw, shown, noise=noise, gain=gain, white_level=top)


def _places(view: View, axis: str) -> Floats:
    """Coordinates (H, W) of the unthinned camera, NaN where nothing is seen."""
    place = view.coordinate(axis)
    if view.stride == 1:
        return place
    rows, cols = (round(n * view.stride) for n in place.shape)
    wider = _extrapolated(_extrapolated(place.T).T)
    fine = np.asarray(cv2.resize(wider, (cols, rows), interpolation=cv2.INTER_LINEAR))
    extent = view.extent(axis)
    return np.where((fine >= -0.5) & (fine <= extent - 0.5), fine, np.nan)


def _of_view(view: View, values: Floats) -> Floats:
    """Means of what lies behind its pixels (H, W), of the unthinned camera's."""
    rows, cols = view.visible.shape
    return np.asarray(cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA))


def _some(view: View, mask: Mask) -> Mask:
    """Of a mask of the unthinned camera, what the view's pixels see."""
    rows, cols = view.visible.shape
    return np.asarray(cv2.resize(mask.astype(np.uint8), (cols, rows), interpolation=cv2.INTER_NEAREST) > 0)


def _extrapolated(place: Floats) -> Floats:
    """With the pixels beside what is seen, along rows."""
    before, behind = np.full(place.shape, np.nan), np.full(place.shape, np.nan)
    before[:, :-2] = 2 * place[:, 1:-1] - place[:, 2:]
    behind[:, 2:] = 2 * place[:, 1:-1] - place[:, :-2]
    wider = np.where(np.isnan(place), before, place)
    return np.where(np.isnan(wider), behind, wider)


def _smooth(table: Floats) -> Floats:
    return np.asarray(uniform_filter1d(table, SMOOTH, mode="nearest"))
