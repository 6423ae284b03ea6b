"""Applies a prepared decoder to frames of one exposure: both axes, then the spatial checks; no estimation."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import over_rows
from optolever.memory import roomy_empty

from .axis import AxisDecoder, Setup
from .correspondence import Correspondence, Flag
from .display import rounded_places, shares_of, take_off
from .exposures import Part
from .flags import Shared, flag_amid_contradictions
from .frames import Light
from .profile.border import NO_BORDER, border_of
from .profile.edge_lines import widen_edge_lines
from .profile.unlike import Before, without_before
from .rig_profile import ExposureProfile
from .spatial import Common, Raw, SpatialLimits, SpatialMaps, SpatialTables, check_rows, despeckle

__all__ = [
    "AxisTables",
    "Maps",
    "Prepared",
    "Steps",
    "applied",
    "border_shares",
    "corrected",
    "decoded_axes",
    "neighbours",
    "rounding_of",
    "tables_of",
    "with_profile",
]

F32 = NDArray[np.float32]
#: Smallest block of a thread, rows and pixels: its data fit the second-level cache; starting its kernels
#: costs as much as some thousand pixels.
_BLOCK, _PIXELS = 32, 40_000
#: Largest number of pixels of joined rows: starting a loop costs as much as some hundred pixels.
_LINE = 1 << 13
#: Smallest sigma of frames without noise beyond rounding, pattern pixels.
_LEAST_SIGMA = 0.01


@dataclass(frozen=True, slots=True)
class Steps:
    """Decoding steps of one exposure: setup, display lag to remove, a decoder per axis.

    spread, steep: variance of linear levels (see Light), and its ratio to the variance of raw levels."""

    setup: Setup
    lag: Before
    decoders: tuple[AxisDecoder, ...]
    spread: F32
    steep: F32

    def light(self, light: Light) -> Light:
        """Frames without lag, with the variances of their levels."""
        if self.lag.share:
            return without_before(light, self.setup.plan, self.lag)
        return replace(light, spread=self.spread, steep=self.steep)


def _block(cols: int) -> int:
    """Rows of a block."""
    return max(_BLOCK, -(-_PIXELS // cols))


class AxisTables(NamedTuple):
    """Of one axis: shift by rounded grey values (empty: none), tables and limits of the spatial checks."""

    rounding: F32
    tables: SpatialTables
    limits: SpatialLimits


@dataclass(frozen=True, slots=True)
class Prepared:
    """A profile of one exposure as the kernels take it."""

    part: Part
    steps: Steps
    tables: tuple[AxisTables, ...]
    profile: ExposureProfile


class Maps(NamedTuple):
    """Per axis coordinate and variance, and shared maps, before the spatial checks."""

    raw: tuple[Raw, ...]
    shared: Shared


def decoded_axes(
    light: Light, steps: Steps, mask: NDArray[np.bool_] | None, rounding: tuple[F32, ...] = ()
) -> Maps:
    """Coordinates and variances of every axis, flags of both, by blocks of rows.

    rounding: per axis, the shift by rounded grey values, which is subtracted (empty: not known)."""
    decoders, shape = steps.decoders, light.raw.shape[1:]
    rows, cols = shape
    raw = tuple(Raw(*(roomy_empty(shape, np.float32) for _ in range(2))) for _ in decoders)
    shared = Shared(roomy_empty(shape, np.uint16), *(roomy_empty(shape, np.float32) for _ in range(3)))
    # join rows, except for look-ups, whose search walks along a row
    most = 1 if any(decoder.table is not None for decoder in decoders) else max(_LINE // cols, 1)
    count = next(n for n in (16, 8, 4, 2, 1) if n <= most and rows % n == 0)
    lines = rows // count, cols * count
    of_axes = [Raw(*(one.reshape(lines) for one in own)) for own in raw]
    of_both = Shared(*(one.reshape(lines) for one in shared))
    longer = replace(light, raw=light.raw.reshape(-1, *lines))

    def block(start: int, stop: int) -> None:
        for i, (decoder, own) in enumerate(zip(decoders, of_axes, strict=True)):
            decoder.decode(longer, (start, stop), own, i == 0, of_both)
            if rounding and rounding[i].size:
                take_off(own.coordinate[start:stop], rounding[i])

    over_rows(block, lines[0], max(_block(cols) // count, 1))
    if mask is not None:
        np.bitwise_or(shared.flags, np.uint16(Flag.INVALID), out=shared.flags, where=~mask)
    flag_amid_contradictions(shared.flags)
    return Maps(raw, shared)


def rounding_of(decoder: AxisDecoder, setup: Setup, width: float) -> F32:
    """Shift by rounded grey values for pixels of a width (cells); empty for ideal cosines and look-ups."""
    if not setup.cells or decoder.periods is None:
        return np.zeros(0, np.float32)
    return rounded_places(decoder.axis.axis, setup.sequence, width)


def corrected(coordinate: F32, rounding: F32) -> None:
    """Subtract the shift by rounded grey values from a coordinate (H, W), in place."""
    if rounding.size:
        rows, cols = coordinate.shape
        over_rows(lambda start, stop: take_off(coordinate[start:stop], rounding), rows, _block(cols))


def border_shares(decoder: AxisDecoder) -> tuple[tuple[float, float], ...]:
    """Periods that the border shifts, with their weights; none for look-ups."""
    return () if decoder.table is not None else shares_of(decoder.axis)


def tables_of(steps: Steps, profile: ExposureProfile, footprint: float) -> tuple[AxisTables, ...]:
    """Tables of each axis; footprint: side of a pixel's active area over its pitch."""
    found = []
    for decoder, own in zip(steps.decoders, profile.axes, strict=True):
        border = border_of(border_shares(decoder), own.border) if steps.setup.cells else NO_BORDER
        limits = SpatialLimits.of(
            reach=border.reach,
            usual=own.width,
            roughness=own.pixelation.roughness,
            least=_LEAST_SIGMA if profile.silent else 0.0,
            extent=float(decoder.axis.extent) if steps.setup.cells else 0.0,
            jump=decoder.jump,
            stripe=decoder.stripe,
            per_turn=decoder.per_turn,
            ends=profile.ends.variance,
            dark=profile.dark,
            lens=profile.lens.variance,
            lens_sigma=profile.lens.sigma,
            footprint=footprint,
        )
        tables = SpatialTables(*own.pixelation.tables(), border.table)
        found.append(AxisTables(rounding_of(decoder, steps.setup, own.width), tables, limits))
    return tuple(found)


def neighbours(maps: Maps, prepared: Prepared) -> Correspondence:
    """Remove pixelation; edges, outliers and partial footprints raise flags or sigma."""
    (raw, shared), decoders = maps, prepared.steps.decoders
    shape = shared.flags.shape
    flags = roomy_empty(shape, np.uint16)
    out = {}
    for axis in "uv":
        pair = SpatialMaps(roomy_empty(shape, np.float32), roomy_empty(shape, np.float32), flags)
        out[axis] = pair
        if axis not in {decoder.axis.axis for decoder in decoders}:
            pair.coordinate[:], pair.sigma[:] = np.nan, np.inf
    common = Common(shared.flags, shared.amplitude, shared.offset)
    every = [
        (own, one.tables, one.limits, out[decoder.axis.axis])
        for decoder, own, one in zip(decoders, raw, prepared.tables, strict=True)
    ]

    def block(start: int, stop: int) -> None:
        flags[start:stop] = shared.flags[start:stop]
        for own, table, limits, into in every:
            check_rows((start, stop), own, common, table, limits, into)

    size = _block(shape[1])
    over_rows(block, shape[0], size)
    over_rows(lambda start, stop: despeckle(start, stop, flags, shared.flags), shape[0], size)
    u, v = out["u"], out["v"]
    both = shared.amplitude, shared.offset, shared.error
    return Correspondence(u.coordinate, v.coordinate, u.sigma, v.sigma, shared.flags, *both)


def with_profile(found: Correspondence, profile: ExposureProfile) -> Correspondence:
    """Inflate sigma of the outermost lines, in place; add notices and shared noise of the profile."""
    sigmas = {"u": found.sigma_u, "v": found.sigma_v}
    widen_edge_lines([sigmas[one.axis] for one in profile.axes], profile.edges)
    return replace(found, notices=profile.notices, shared_noise=profile.shared)


def applied(light: Light, prepared: Prepared, mask: NDArray[np.bool_] | None) -> Correspondence:
    """Decode frames (see Steps.light) of the prepared exposure."""
    maps = decoded_axes(light, prepared.steps, mask, tuple(one.rounding for one in prepared.tables))
    return with_profile(neighbours(maps, prepared), prepared.profile)
