"""decode(): frames and their descriptions -> Correspondence."""

from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.blocks import over_rows
from optolever.memory import roomy_empty
from optolever.patterns import Sequence

from .arrays import axis_arrays, chi_squared_limit
from .axis_kernels import CODE_GUIDED, CODE_ONLY, SEARCHED, SPAN_GUIDED, axis_rows
from .blur import measured_blur, median_footprint, surveyed_rows, with_partners
from .cells import take_off_stairs
from .code_kernels import FROM_EXTREMES, FROM_PAIRS, FROM_WHITE_BLACK
from .correspondence import Correspondence, Flag
from .display import NO_TABLES, Tables, display_tables
from .exposures import better_of, by_exposure
from .flag_kernels import outlier_rows
from .integrity import examine
from .job import Job, check_camera, checked, clip_level, job_of, levels_of
from .neighbour_kernels import REACH, bend_rows, mixed_rows, steep_rows
from .noise import QUANTISATION
from .plan import AxisPlan, Code, Plan, plan
from .raster import by_raster, raster_of
from .references import beyond_references
from .response import Response
from .sweep import stripe_step
from .table_decoder import by_table, shown_on, subpixel_step, table_step

__all__ = ["decode"]

#: Systematic error of a code's margin that is always reckoned with, in units of half the contrast.
LOOSE = 0.02
#: Share of the clip level below which a pixel without contrast counts as dark.
_DARK = 0.02
#: Of a code alone: footprint beyond which a cell is none, cells; those at the border that blur leaves right.
_STEEP_CELLS, _SURE_CELLS = 3.0, 1.5
#: That footprint for XOR-Gray, whose bits all have their edges at the same places.
_STEEP_XOR = 2.0
#: Median second difference of a map whose neighbours tell nothing of each other, pattern pixels.
_BENT = 2.0
_BLOCK = 32
Frames = NDArray[Any]


def decode(
    frames: ArrayLike,
    sequence: Sequence,
    *,
    noise: float | None = None,
    gain: float = 0.0,
    white_level: float | None = None,
    response: Response | None = None,
    weigh_samples: bool = False,
    blur_px: float | None = None,
    on_cells: bool = True,
    subpixel: bool = False,
) -> Correspondence:
    """Where on the pattern every camera pixel looks.

    frames       (N, H, W) uint8 or uint16 (floats are taken, too), frame i as sequence.frames[i] describes it
    noise, gain  of the camera: variance = noise^2 + gain * level, levels of the frames before rounding;
                 without `noise` both are estimated from the frames
    white_level  level at which the camera clips; default 255, for uint16 the 10, 12, 14 or 16 bits in use
    response     camera level against shown level, inverted first; noise is then always estimated (of grey
                 values, as the same for all levels)
    weigh_samples  with a response, whose inverse magnifies the noise of dark levels: weigh every sample by
                 its noise. Best where noise limits; equal weights where what the response leaves over does
    blur_px      rms blur between display and camera, cells; default: estimated (see cells.take_off_stairs)
    on_cells     fringes were shown on the cells of a surface of the sequence's size, as Frame.tables says,
                 dark around it; what that shifts is taken off (see display, cells). False: ideal cosines
    subpixel     binary codes: answers within their cells, from the blur of their edges, where it tells

    A code under several exposures is decoded from each that shows all of it, every pixel from its best one:
    amplitude and offset are levels of that exposure. InputError if frames and sequence do not fit or hold
    values that are not finite.
    """
    stack = checked(frames, sequence)
    check_camera(noise, gain, white_level)
    clip = clip_level(stack) if white_level is None else float(white_level)
    raster = raster_of(sequence)
    if raster is not None:
        rounding = QUANTISATION if stack.dtype.kind == "u" else 0.0

        def stripes(sums: Frames, swept: Sequence, full: float, summed: int) -> Correspondence:
            of_sums = None if noise is None else float(np.sqrt(summed * (noise**2 + rounding)))
            return decode(sums, swept, noise=of_sums, gain=gain, white_level=full)

        return by_raster(stack, sequence, raster, clip, levels_of(stack, response)[0], stripes)
    found = []
    for part in by_exposure(sequence):
        own = stack if len(part.index) == len(stack) else stack[part.index]
        job = job_of(own, plan(part.sequence), noise, gain, clip, response, weigh_samples, subpixel)
        found.append(_decoded(job, part.sequence, blur_px, on_cells, subpixel))
    return reduce(better_of, found)


def _decoded(
    job: Job, sequence: Sequence, blur_px: float | None, on_cells: bool, subpixel: bool
) -> Correspondence:
    """decode of frames whose codes are of one exposure."""
    stack = job.frames
    wanted = plan(sequence)
    _, height, width = stack.shape
    shown = {axis.axis for axis in wanted.axes}
    maps = {axis: _maps(height, width, axis in shown) for axis in "uv"}
    flags = roomy_empty((height, width), np.uint16)
    amplitude, offset, order_error = (roomy_empty((height, width), np.float32) for _ in range(3))
    common = (flags, amplitude, offset, order_error)

    def steps(tables: dict[str, Tables]) -> list[Callable[[int, int], None]]:
        return [
            _step(
                job, sequence, wanted, axis, subpixel, tables.get(axis.axis), maps[axis.axis], i > 0, *common
            )
            for i, axis in enumerate(wanted.axes)
        ]

    tables: dict[str, Tables] = {}
    blurs: dict[str, float | None] = {}
    on_display = [
        axis for axis in wanted.axes if axis.fringes and on_cells and not (sequence.nominal or by_table(axis))
    ]
    # what takes each block by itself, so that some rows can be asked for before the rest
    by_rows = not subpixel and all(axis.stripes is None and not by_table(axis) for axis in wanted.axes)
    rows = surveyed_rows(height, wanted)
    if on_display or by_rows:
        for step in steps({}):
            for row in with_partners(rows, height):
                step(int(row), int(row) + 1)
    for axis in on_display:
        coord = maps[axis.axis][0]
        blur = blur_px
        if blur is None:
            blur = measured_blur(stack, job.lut, wanted, axis, coord, flags, rows)
        tables[axis.axis] = display_tables(sequence, axis, median_footprint(coord, rows), blur)
        blurs[axis.axis] = blur
    work = steps(tables)
    neighbours = _neighbours(job, wanted, blurs, maps, flags, amplitude, offset)
    at_once = by_rows and all(_continuous(*maps[name], rows) for name in shown)

    def block(start: int, stop: int) -> None:
        for step in work:
            step(start, stop)
        if at_once:  # while they are in the cache, all rows whose neighbours are in this block
            neighbours(start + REACH if start else 0, stop - REACH if stop < height else height)

    def seams(first: int, last: int) -> None:
        for k in range(first, last):
            neighbours((k + 1) * _BLOCK - REACH, min((k + 1) * _BLOCK + REACH, height))

    over_rows(block, height, _BLOCK)
    if at_once:
        over_rows(seams, (height - 1) // _BLOCK, 4)
    elif not by_rows and all(_continuous(*maps[name], rows) for name in shown):
        over_rows(neighbours, height, _BLOCK)
    found = Correspondence(
        maps["u"][0], maps["v"][0], maps["u"][1], maps["v"][1], flags, amplitude, offset, order_error
    )
    _flag_wrong_frames(stack, wanted, found)
    for axis in on_display:
        if not tables[axis.axis].stairs:
            take_off_stairs(axis.fringes[-1].period, *maps[axis.axis], flags, blur_px, blurs[axis.axis])
    return found


def _flag_wrong_frames(stack: Frames, wanted: Plan, found: Correspondence) -> None:
    """Flag what frames spoil that are not those described (see integrity)."""
    wrong = np.uint16(Flag.WRONG_FRAME)
    for finding in examine(stack, wanted, found).findings:
        rows = slice(*finding.rows) if finding.rows else slice(None)
        if finding.spoilt and finding.span is None:
            found.flags[rows] |= wrong
        elif finding.spoilt and finding.span is not None:
            name, low, high = finding.span
            coord = getattr(found, name)[rows]
            found.flags[rows] |= np.where((coord >= low) & (coord <= high), wrong, np.uint16(0))


def _continuous(coord: Frames, sigma: Frames, rows: NDArray[np.int64]) -> bool:
    """Whether neighbours look at neighbouring places, so that they tell something of each other."""
    at = np.arange(0, coord.shape[1] - 2, max(1, coord.shape[1] // 256))
    lines = coord[rows]
    bend = np.abs(lines[:, at] - 2 * lines[:, at + 1] + lines[:, at + 2])
    return bool(bend.size and np.median(bend) < max(_BENT, 5 * np.median(sigma[rows][:, at])))


def _neighbours(
    job: Job,
    wanted: Plan,
    blurs: dict[str, float | None],
    maps: dict[str, tuple[Frames, Frames]],
    flags: Frames,
    amplitude: Frames,
    offset: Frames,
) -> Callable[[int, int], None]:
    """The work on a block of rows that needs decoded rows around it."""
    shown = {axis.axis: axis for axis in wanted.axes}
    codes = {name: axis.code for name, axis in shown.items() if axis.code and not axis.fringes}
    coded = {name: code.cell for name, code in codes.items()}
    most = {
        name: code.cell * (_STEEP_XOR if code.kind == "xor-gray" else _STEEP_CELLS)
        for name, code in codes.items()
    }
    noise = job.raw_noise if coded else job.noise
    # of other codes the blur is known, and with it what the border does
    dim = {name for name in shown if name in coded or blurs.get(name, 0.0) is None}
    extents = tuple(float(shown[name].extent) if name in dim else np.inf for name in "uv")
    # cells at the border are read right as long as blur is no wider than they are
    nearest = tuple(_SURE_CELLS * coded[name] if name in coded else -np.inf for name in "uv")

    def step(start: int, stop: int) -> None:
        for name in shown:
            if name in coded:
                steep_rows(start, stop, most[name], maps[name][0], flags)
            else:
                bend_rows(start, stop, *maps[name], flags)
        mixed_rows(
            *(start, stop, noise.read2, noise.gain, extents, nearest),
            *(maps["u"][0], maps["v"][0], maps["u"][1], maps["v"][1], amplitude, offset, flags),
        )

    return step


def _maps(height: int, width: int, shown: bool) -> tuple[Frames, Frames]:
    """Coordinate and sigma; those of an axis that was shown are written whole later on."""
    if shown:
        return roomy_empty((height, width), np.float64), roomy_empty((height, width), np.float32)
    return np.full((height, width), np.nan), np.full((height, width), np.inf, np.float32)


def _step(
    job: Job,
    sequence: Sequence,
    wanted: Plan,
    axis: AxisPlan,
    subpixel: bool,
    tables: Tables | None,
    maps: tuple[Frames, Frames],
    joined: bool,
    *common: Frames,
) -> Callable[[int, int], None]:
    """The work on a block of rows for one axis: which decoder its frames ask for."""
    if axis.stripes is not None and not (axis.code or axis.fringes or axis.levels):
        return stripe_step(job.light, job.bright, axis, joined, maps, common, job.told)
    if by_table(axis):
        shown, even = shown_on(sequence, wanted, axis), job.light is job.frames
        return table_step(job.light, job.bright, shown, axis, joined, maps, common, even)
    step = _axis_step(job, sequence, wanted, axis, tables or NO_TABLES, maps, joined, *common)
    if subpixel and axis.code is not None and not axis.fringes:
        return subpixel_step(job.light, job.bright, shown_on(sequence, wanted, axis), step, maps)
    return step


def _axis_step(
    job: Job,
    sequence: Sequence,
    wanted: Plan,
    axis: AxisPlan,
    tables: Tables,
    maps: tuple[Frames, Frames],
    joined: bool,
    *common: Frames,
) -> Callable[[int, int], None]:
    """The work on a block of rows for one axis."""
    arrays = axis_arrays(sequence, axis.axis)
    fringes = (
        *(arrays.count, arrays.index, arrays.solve, arrays.model, arrays.quad),
        *(arrays.even, arrays.quarters, arrays.periods, arrays.misfit),
    )
    code = _code_arguments(job, wanted, axis)
    limits = (_reach(axis), job.floor, chi_squared_limit(len(axis.fringes) - 1))
    dark = _DARK * job.clip if job.clip < np.inf else 0.0
    noise = (job.noise.read2, job.noise.gain, dark)
    scale = float(job.slope[128]) ** 2 if len(job.slope) else 1.0
    response = (job.lut, job.slope, scale)
    mode = _mode(axis)
    least = 8 * axis.code.cell if axis.code and not axis.fringes else 0.4 * float(arrays.periods[-1])

    count, height, width = job.frames.shape
    frames = job.frames.reshape(count, 1, height * width)
    flat = [chart.reshape(1, height * width) for chart in (*maps, *common)]

    def step(start: int, stop: int) -> None:
        axis_rows(
            *(frames, response, job.clip, noise, start * width, stop * width, mode, code, fringes, limits),
            *(tables.kernel, axis.extent, joined, *flat),
        )  # fmt: skip
        outlier_rows(start, stop, least, maps[0], common[0])

    return step


def _code_arguments(job: Job, wanted: Plan, axis: AxisPlan) -> tuple[Any, ...]:
    """What axis_rows wants to know of the code; of none, if there is none."""
    none = np.empty(0, np.int64)
    code = axis.code or Code("", none, none, 1.0, 0.0, np.empty(0, np.int32))
    cells = int(np.ceil((axis.extent - code.origin) / code.cell))
    origin = 0.5 * (code.cell - 1) + code.origin
    source = _source(wanted, code)
    return (
        (
            *(source, wanted.white, wanted.black, code.plain, code.inverse),
            *(code.kind == "gray", code.cells, cells, code.cell, origin),
        ),
        (
            np.float32(LOOSE),
            np.float32(beyond_references(job.frames, wanted, code)),
            np.float32(job.raw_noise.read2),
            np.float32(job.raw_noise.gain),
        ),
    )


def _source(wanted: Plan, code: Code) -> int:
    if wanted.white >= 0 and wanted.black >= 0:
        return FROM_WHITE_BLACK
    return FROM_PAIRS if ((code.plain >= 0) & (code.inverse >= 0)).any() else FROM_EXTREMES


def _mode(axis: AxisPlan) -> int:
    if not axis.fringes:
        return CODE_ONLY
    if axis.code is not None:
        return CODE_GUIDED
    return SPAN_GUIDED if axis.fringes[0].period >= axis.extent else SEARCHED


def _reach(axis: AxisPlan) -> float:
    """How far a coordinate may lie from the centre of the code's cell."""
    if axis.code is None or not axis.fringes:
        return float("inf")
    period = axis.fringes[0].period
    return min(axis.code.cell / 2 + period / 8, period * 15 / 32)
