"""decode(): frames and their descriptions -> Correspondence."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.blocks import Work, on_cores, on_threads, over_blocks, shrinking
from optolever.compiling import uncollected
from optolever.patterns import Sequence

from .blur import measured_blur
from .cells import Stairs, given_stairs, left_by, read_stairs, stairs_matter, take_off_stairs
from .correspondence import Correspondence, Flag
from .display import Tables, display_tables
from .exposures import better_of, by_exposure
from .integrity import Finding, Integrity, examine, rule_faults
from .jit import compiled_for
from .job import Job, check_camera, checked, clip_level, job_of, levels_of
from .noise import QUANTISATION
from .plan import AxisPlan, Plan, plan
from .raster import by_raster, raster_of
from .records import Near
from .response import Response
from .rows import Maps, axes_blocks, near_of, near_step, shadow_step
from .survey import steps, survey
from .survivors import flag_survivors
from .sweep import Sweep, calibrated, stripe_step, swept_alone
from .swing import Blur
from .table_decoder import by_table, shown_on, subpixel_step, table_step

__all__ = ["decode"]

#: Rows of a block that a thread takes, at least; rows on which maps are tested for being continuous.
_BLOCK, _SAMPLED = 16, 24
Frames = NDArray[Any]


@uncollected()
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
    blur_px      rms blur between display and camera, cells; default: estimated (see blur, gathering)
    on_cells     frames were shown on the cells of a surface of the sequence's size, as Frame.tables says,
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
            return decode(
                *(sums, swept),
                noise=of_sums,
                gain=gain,
                white_level=full,
                blur_px=blur_px,
                on_cells=on_cells,
            )

        return by_raster(stack, sequence, raster, clip, levels_of(stack, response)[0], stripes)
    found = []
    for part in by_exposure(sequence):
        own = stack if len(part.index) == len(stack) else stack[part.index]
        wanted = plan(part.sequence)
        with compiled_for(*_uses(wanted)):
            job = job_of(own, wanted, noise, gain, clip, response, weigh_samples, subpixel)
            found.append(_decoded(job, part.sequence, blur_px, on_cells, subpixel))
    return reduce(better_of, found)


def _uses(wanted: Plan) -> list[str]:
    """What is shown, in the words of compiled_for."""
    by_rows = [axis for axis in wanted.axes if not by_table(axis)]
    shown = {
        "code": any(axis.code for axis in by_rows),
        "fringes": any(axis.fringes for axis in by_rows),
        "code alone": any(axis.code and not axis.fringes for axis in by_rows),
    }
    return ["all", *(use for use, asked in shown.items() if asked)]


@dataclass(frozen=True, slots=True)
class _Surveyed:
    """What a sample tells of every axis: tables of what the display shifts, blur, usual footprint (cells);
    whether all of them are continuous."""

    tables: dict[str, Tables]
    blurs: dict[str, Blur | None]
    footprints: dict[str, float]
    continuous: bool


_NOTHING = _Surveyed({}, {}, {}, False)


def _surveyed(
    job: Job,
    sequence: Sequence,
    wanted: Plan,
    plain: tuple[AxisPlan, ...],
    on_display: list[AxisPlan],
    blur_px: float | None,
) -> _Surveyed:
    """plain: axes that kernels decode by rows; on_display: those with fringes that cells showed."""
    seen = survey(job, sequence, wanted, plain, few=not on_display)
    along = {axis.axis: seen.steps(axis.axis) for axis in plain}
    footprints = {name: own.footprint for name, own in along.items()}

    def measure(axis: AxisPlan) -> Blur | None:
        return measured_blur(seen, job.lut, wanted, axis) if blur_px is None else Blur(blur_px, 0.0)

    told = [measure(axis) for axis in on_display]  # short steps: threads would wait for each other
    # where one axis does not tell, what the other tells is nearer than nothing
    usual = next((blur for blur in told if blur is not None), None)
    blurs = {axis.axis: blur or usual for axis, blur in zip(on_display, told, strict=True)}
    tables = {}
    for axis in on_display:
        known = blurs[axis.axis]
        rms = None if known is None else known.rms
        tables[axis.axis] = display_tables(sequence, axis, footprints[axis.axis], rms)
    return _Surveyed(tables, blurs, footprints, all(own.continuous for own in along.values()))


def _decoded(
    job: Job, sequence: Sequence, blur_px: float | None, on_cells: bool, subpixel: bool
) -> Correspondence:
    """decode of frames whose codes are of one exposure."""
    wanted = plan(sequence)
    height, width = job.frames.shape[1:]
    maps = Maps((height, width), {axis.axis for axis in wanted.axes})
    cells = on_cells and not sequence.nominal
    plain = tuple(axis for axis in wanted.axes if (axis.code or axis.fringes) and not by_table(axis))
    on_display = [axis for axis in plain if axis.fringes and cells]
    # kernels do both axes and, where these are continuous, compare neighbours in one go
    by_rows = not subpixel and plain == wanted.axes and all(axis.stripes is None for axis in plain)
    told = _NOTHING
    if on_display or by_rows:
        told = _surveyed(job, sequence, wanted, plain, on_display, blur_px)
    at_once = by_rows and told.continuous
    sweeps = {
        axis.axis: calibrated(job.light, job.bright, axis.stripes, job.told)
        for axis in wanted.axes
        if axis.stripes is not None and swept_alone(axis)
    }
    near = near_of(job, wanted, told.blurs, told.footprints, maps)
    cuts = shrinking(height, _BLOCK)
    faults: list[Finding] = []

    def check() -> None:
        faults.extend(rule_faults(job.frames, job.sample, wanted))

    if by_rows:
        blocks = axes_blocks(job, sequence, wanted, plain, told.tables, maps, near=near, compare=at_once)
        on_threads(blocks(cuts), len(cuts) - 1, meanwhile=check)
    else:
        block = _one_by_one(
            _step(job, sequence, wanted, axis, subpixel, told.tables, sweeps, maps, near, i > 0)
            for i, axis in enumerate(wanted.axes)
        )
        over_blocks(block, cuts, meanwhile=check)
    if not by_rows and _continuous(wanted, maps):
        over_blocks(near_step(near, maps), cuts)
    if near.dim.any():
        over_blocks(shadow_step(near, maps), cuts)
    found = Correspondence(
        *(maps.coord["u"], maps.coord["v"], maps.sigma["u"], maps.sigma["v"]),
        *maps.common,
    )
    _flag_wrong_frames(examine(job.frames, wanted, found, tuple(faults)), found)

    high = [axis for axis in on_display if not told.tables[axis.axis].stairs]
    if cells:
        within = [axis for axis in wanted.axes if subpixel and axis.code is not None and not axis.fringes]
        high += within + [axis for axis in wanted.axes if swept_alone(axis) or by_table(axis)]
    least = max((sweep.least_blur for sweep in sweeps.values()), default=0.0)
    _take_off_stairs(high, maps, blur_px, told.blurs, least)
    flag_survivors(found.flags)
    return found


def _take_off_stairs(
    axes: list[AxisPlan],
    maps: Maps,
    blur_px: float | None,
    measured: dict[str, Blur | None],
    least: float,
) -> None:
    """Undo the display's stairs, of a blur given, read off the stairs, or measured otherwise; least: what it
    surely is (cells)."""

    def read(axis: AxisPlan) -> Stairs:
        if blur_px is not None:
            return given_stairs(axis, blur_px)
        own = read_stairs(axis, *maps.of(axis.axis), maps.flags)
        # the contrast of long periods tells little of it
        return own.of_blur(measured.get(axis.axis))

    told = on_cores(read, axes)
    # an axis whose pixels keep step with the cells cannot tell: the other one's is the same display
    most = max((stairs.left for stairs in told), default=0.0)
    at_most = min((stairs.largest for stairs in told), default=1.0)
    told = [stairs.known(most).limited(min(at_most, left_by(least))) for stairs in told]

    def take_off(i: int) -> None:
        take_off_stairs(told[i], axes[i].extent, *maps.of(axes[i].axis), maps.flags)

    on_cores(take_off, [i for i, axis in enumerate(axes) if stairs_matter(told[i], *maps.of(axis.axis))])


def _one_by_one(steps: Iterable[Work]) -> Work:
    """All of them on a block."""
    every = tuple(steps)

    def block(start: int, stop: int) -> None:
        for step in every:
            step(start, stop)

    return block


def _continuous(wanted: Plan, maps: Maps) -> bool:
    """Whether neighbours on decoded maps tell something of each other."""
    rows = slice(None, None, max(1, len(maps.flags) // _SAMPLED))
    some = [tuple(np.ascontiguousarray(chart[rows]) for chart in maps.of(axis.axis)) for axis in wanted.axes]
    return all(steps(coord, coord, sigma, 1).continuous for coord, sigma in some)


def _flag_wrong_frames(seen: Integrity, found: Correspondence) -> None:
    """Flag what frames spoil that are not those described (see integrity)."""
    wrong = np.uint16(Flag.WRONG_FRAME)
    for finding in seen.findings:
        rows = slice(*finding.rows) if finding.rows else slice(None)
        if finding.spoilt and finding.span is None:
            found.flags[rows] |= wrong
        elif finding.spoilt and finding.span is not None:
            name, low, high = finding.span
            coord = getattr(found, name)[rows]
            found.flags[rows] |= np.where((coord >= low) & (coord <= high), wrong, np.uint16(0))


def _step(
    job: Job,
    sequence: Sequence,
    wanted: Plan,
    axis: AxisPlan,
    subpixel: bool,
    tables: dict[str, Tables],
    sweeps: dict[str, Sweep],
    maps: Maps,
    near: Near,
    joined: bool,
) -> Work:
    """The work on a block of rows for one axis: which decoder its frames ask for."""
    own, common = maps.of(axis.axis), maps.common
    if swept_alone(axis):
        return stripe_step(job.light, job.bright, sweeps[axis.axis], axis, joined, own, common)
    if by_table(axis):
        shown, even = shown_on(sequence, wanted, axis), job.light is job.frames
        return table_step(job.light, job.bright, shown, axis, joined, own, common, even)
    blocks = axes_blocks(job, sequence, wanted, (axis,), tables, maps, near=near, joined=joined)

    def step(start: int, stop: int) -> None:
        blocks((start, stop))()

    if subpixel and axis.code is not None and not axis.fringes:
        shown = shown_on(sequence, wanted, axis)
        return subpixel_step(job.light, job.bright, shown, step, own, job.noise.read2)
    return step
