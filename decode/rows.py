"""Work on a block of rows: what block_kernels is told of a job, and the calls."""

from collections.abc import Callable, Mapping
from collections.abc import Sequence as Numbers
from threading import local
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import Work
from optolever.memory import roomy_empty, roomy_together
from optolever.patterns import Sequence

from .arrays import axis_arrays, chi_squared_limit
from .block_kernels import decode_blocks
from .code_kernels import FROM_EXTREMES, FROM_PAIRS, FROM_WHITE_BLACK
from .display import NO_TABLES, Tables
from .job import Job
from .mixed_kernels import NOTHING, READ, shadow_rows
from .neighbour_kernels import near_rows
from .plan import AxisPlan, Code, Plan
from .records import AxisRecord, Camera, CodeRecord, FringeRecord, Near, Scratch, Shared, Steep, scratch
from .references import beyond_references
from .swing import Blur
from .unwrap_kernels import MUCH_FINER

__all__ = ["LOOSE", "Maps", "axes_blocks", "near_of", "near_step", "shadow_step"]

Map = NDArray[Any]
F32 = np.float32
#: Systematic error of a code's margin that is always reckoned with, in units of half the contrast.
LOOSE = 0.02
#: Share of the clip level below which a pixel without contrast counts as dark.
_DARK = 0.02
#: Of a code alone: footprint beyond which a cell is none, cells; those at the border that blur leaves right.
_STEEP_CELLS, _SURE_CELLS = 3.0, 1.5
#: That footprint for XOR-Gray, whose bits all have their edges at the same places.
_STEEP_XOR = 2.0
#: Scratch that every thread keeps: of decoding and of comparing neighbours, for two widths.
_KEPT = 4
_own = local()
#: Where rows are cut into blocks -> what every thread is to call, which does blocks that no other has begun.
Blocks = Callable[[Numbers[int]], Callable[[], None]]
#: Cells from the border up to which it may throw a shadow: in a strong blur; in periods of a fringe, 2 sigma
#: (2 % of the light) of the blur that leaves 2 % of its contrast.
_SHADOW, _SHADOW_PERIODS = 16.0, 0.9


class Maps:
    """What a decode writes: coord and sigma (H, W) of each axis, NaN and inf if it was not shown, and what
    both share; what was shown is written whole later on."""

    def __init__(self, shape: tuple[int, int], shown: set[str], *, briefly: bool = False) -> None:
        """briefly: all of them are dropped at the same time."""
        here = [name for name in "uv" if name in shown]
        kinds = [np.float64] * len(here) + [F32] * (len(here) + 3) + [np.uint16]
        if briefly:
            rooms = iter(roomy_together(shape, kinds))
        else:
            rooms = (roomy_empty(shape, kind) for kind in kinds)
        self.coord: dict[str, Map] = {name: next(rooms) for name in here}
        self.sigma: dict[str, Map] = {name: next(rooms) for name in here}
        self.amplitude, self.offset, self.order_error, self.flags = rooms
        for name in set("uv") - shown:
            self.coord[name] = np.full(shape, np.nan)
            self.sigma[name] = np.full(shape, np.inf, F32)

    @property
    def common(self) -> tuple[Map, Map, Map, Map]:
        """The shared ones."""
        return self.flags, self.amplitude, self.offset, self.order_error

    def of(self, name: str) -> tuple[Map, Map]:
        """Coordinate and sigma of an axis."""
        return self.coord[name], self.sigma[name]

    @property
    def shared(self) -> Shared:
        """The shared ones as the kernels take them."""
        return Shared(self.flags, self.amplitude, self.offset, *map(_flat, self.common))


def _flat(chart: Map) -> Map:
    return chart.reshape(1, -1)


def axes_blocks(
    job: Job,
    sequence: Sequence,
    wanted: Plan,
    axes: tuple[AxisPlan, ...],
    tables: dict[str, Tables],
    maps: Maps,
    *,
    near: Near,
    compare: bool = False,
    joined: bool = False,
) -> Blocks:
    """The work for one axis or both of bits and fringes; joined: another axis went before; compare: so are
    neighbours, as `near` says.
    """
    count, height, width = job.frames.shape
    camera = _camera(job, job.frames.reshape(count, 1, height * width))
    one, *others = (
        _axis_record(job, sequence, wanted, axis, tables.get(axis.axis, NO_TABLES), maps, joined or i > 0)
        for i, axis in enumerate(axes)
    )
    two, shared = others[0] if others else None, maps.shared
    fringes = [axis.fringes.frame.shape for axis in (one, *others) if axis.fringes]
    periods = max((shape[0] for shape in fringes), default=0)
    samples = max((shape[1] for shape in fringes), default=0) if len(job.lut) else 0
    room = _rooms(width, periods, samples)

    def blocks(cuts: Numbers[int]) -> Callable[[], None]:
        at, drawn = np.array(cuts), np.zeros(len(cuts), np.int64)

        def share() -> None:
            decode_blocks(at, drawn, compare, near, camera, one, two, shared, room())

        return share

    return blocks


def _rooms(width: int, periods: int = 0, samples: int = 0) -> Callable[[], Scratch]:
    """Scratch of the thread that asks: the one that it had for such images last, if there is one."""
    wanted = width, periods, samples

    def room() -> Scratch:
        kept = cast(dict[tuple[int, int, int], Scratch], _own.__dict__)
        if wanted not in kept:
            while len(kept) >= _KEPT:
                kept.pop(next(iter(kept)))
            kept[wanted] = scratch(*wanted)
        return kept[wanted]

    return room


def near_step(near: Near, maps: Maps) -> Work:
    """The comparison with neighbours alone, whatever decoded them."""
    shared, room = maps.shared, _rooms(maps.flags.shape[1])

    def step(start: int, stop: int) -> None:
        near_rows(start, stop, near, True, shared, room())

    return step


def shadow_step(near: Near, maps: Maps) -> Work:
    """What the comparison has left, once all rows are compared."""
    shared, room = maps.shared, _rooms(maps.flags.shape[1])

    def step(start: int, stop: int) -> None:
        if near.dim[start:stop].any():
            shadow_rows(start, stop, near, shared, room())

    return step


def near_of(
    job: Job, wanted: Plan, blurs: Mapping[str, Blur | None], footprints: Mapping[str, float], maps: Maps
) -> Near:
    """What is asked of neighbours; blurs: of the axes on whose display fringes were shown; footprints: usual
    ones of the axes, where these are known."""
    shown = {axis.axis: axis for axis in wanted.axes}
    codes = {name: axis.code for name, axis in shown.items() if axis.code and not axis.fringes}
    most = {name: _steep(code, footprints.get(name, 0.0)) for name, code in codes.items()}
    least = {name: _outlying(axis) for name, axis in shown.items()}
    noise = job.raw_noise if codes else job.noise
    # of other codes the blur is known, and with it what the border does
    dim = {name for name in shown if name in codes or (name in blurs and blurs[name] is None)}
    extents = tuple(float(shown[name].extent) if name in dim else np.inf for name in "uv")
    bands = {name: _shadow_band(shown[name]) if name in dim else (np.inf, -np.inf) for name in "uv"}
    return Near(
        shown=("u" in shown, "v" in shown),
        steep=(most.get("u"), most.get("v")),
        least=(least.get("u", F32(np.inf)), least.get("v", F32(np.inf))),
        read2=F32(noise.read2),
        gain=F32(noise.gain),
        extents=(extents[0], extents[1]),
        bands=(bands["u"], bands["v"]),
        u=maps.coord["u"],
        v=maps.coord["v"],
        sigma_u=maps.sigma["u"],
        sigma_v=maps.sigma["v"],
        dim=np.zeros(len(maps.flags), np.uint8),
    )


def _outlying(axis: AxisPlan) -> np.float32:
    """Distance of an outlier from its neighbours, pattern pixels."""
    return F32(0.4 * axis.fringes[-1].period if axis.fringes else 8 * axis.code.cell if axis.code else np.inf)


def _steep(code: Code, footprint: float) -> Steep:
    """Of a code alone, see near_block."""
    most = code.cell * (_STEEP_XOR if code.kind == "xor-gray" else _STEEP_CELLS)
    if footprint > most:
        # those that look right may do so by chance: doubtful neighbours tell, too, and half of it is enough
        return F32(0.5 * most), F32(code.cell), NOTHING
    return F32(most), F32(code.cell), READ


def _shadow_band(axis: AxisPlan) -> tuple[float, float]:
    """Distances from the border, cells, between which its shadow may spoil an answer."""
    if not axis.fringes:
        # cells at the border are read right as long as blur is no wider than they are
        return _SURE_CELLS * (axis.code.cell if axis.code else 1.0), _SHADOW
    # more blur, and nothing would be left of the fringes
    return -np.inf, min(_SHADOW, _SHADOW_PERIODS * axis.fringes[-1].period)


def _camera(job: Job, frames: Map) -> Camera:
    return Camera(
        frames=frames,
        lut=job.lut if len(job.lut) else None,
        slope=job.slope,
        scale=F32(float(job.slope[128]) ** 2 if len(job.slope) else 1.0),
        clip=float(job.clip),
        read2=F32(job.noise.read2),
        gain=F32(job.noise.gain),
        of_code=(F32(job.raw_noise.read2), F32(job.raw_noise.gain)),
        dark=F32(_DARK * job.clip if job.clip < np.inf else 0.0),
        floor=F32(job.floor),
    )


def _axis_record(
    job: Job, sequence: Sequence, wanted: Plan, axis: AxisPlan, tables: Tables, maps: Maps, joined: bool
) -> AxisRecord:
    """All that concerns one axis."""
    code = _code_record(job, wanted, axis, axis.code) if axis.code else None
    coord, sigma = maps.of(axis.axis)
    return AxisRecord(
        code=code,
        alone=None if axis.fringes else code,
        fringes=_fringe_record(job, sequence, axis, tables) if axis.fringes else None,
        extent=float(axis.extent),
        least=_outlying(axis),
        joined=joined,
        number="uv".index(axis.axis),
        coord=coord,
        sigma=sigma,
    )


def _code_record(job: Job, wanted: Plan, axis: AxisPlan, code: Code) -> CodeRecord:
    return CodeRecord(
        source=_source(wanted, code),
        white=wanted.white,
        black=wanted.black,
        plain=code.plain,
        inverse=code.inverse,
        gray=code.kind == "gray",
        cells=code.cells,
        together=code.together,
        fringed=bool(axis.fringes),
        edges=job.edges[axis.axis],
        loose=F32(LOOSE),
        beyond=F32(beyond_references(job.frames, wanted, code)),
        pitch=F32(code.cell),
        origin=F32(0.5 * (code.cell - 1) + code.origin),
        most=np.int32(np.ceil((axis.extent - code.origin) / code.cell)),
        bytes=True if _in_bytes(job, axis, code) else None,
    )


def _in_bytes(job: Job, axis: AxisPlan, code: Code) -> bool:
    """Whether byte_kernels know such a code."""
    paired = bool(((code.plain >= 0) & (code.inverse >= 0)).all())
    return not axis.fringes and job.frames.dtype == np.uint8 and paired and len(code.plain) < 16


def _source(wanted: Plan, code: Code) -> int:
    if wanted.white >= 0 and wanted.black >= 0:
        return FROM_WHITE_BLACK
    return FROM_PAIRS if ((code.plain >= 0) & (code.inverse >= 0)).any() else FROM_EXTREMES


def _fringe_record(job: Job, sequence: Sequence, axis: AxisPlan, tables: Tables) -> FringeRecord:
    arrays, linear = axis_arrays(sequence, axis.axis), not len(job.lut)
    alone = axis.code is None and axis.fringes[0].period >= axis.extent
    whole = job.frames.dtype.kind == "u"  # and no sum of them is beyond numbers
    two = len(arrays.periods) == 2 and bool(MUCH_FINER * arrays.periods[1] < arrays.periods[0])
    return FringeRecord(
        samples=arrays.count,
        frame=arrays.index,
        own=np.arange(arrays.index.shape[1]),
        solve=arrays.solve,
        model=arrays.model,
        quad=arrays.quad,
        even=arrays.even,
        quarters=arrays.quarters,
        unlike=None if arrays.quarters.all() else True,
        periods=arrays.periods,
        misfit=arrays.misfit.astype(F32),
        searched=None if alone or axis.code is not None else True,
        pair=True if alone and two and arrays.quarters.all() and linear and whole else None,
        reach=F32(_reach(axis)),
        disagreement=F32(chi_squared_limit(len(axis.fringes) - 1)),
        shown=tables.kernel,
    )


def _reach(axis: AxisPlan) -> float:
    """How far a coordinate may lie from the centre of the code's cell."""
    if axis.code is None:
        return float("inf")
    period = axis.fringes[0].period
    return min(axis.code.cell / 2 + period / 8, period * 15 / 32)
