"""Cells to rows: frames are rendered once, decoded once per decoder, then reconstructed by every solver."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.records import silent
from optolever.scene import dent_from_text

from ..metrics import rms
from ..own_sequence import own_sequence
from ..paper.line import lattice_frames, lattice_positions, seen_points
from ..paper.recursion import recursion
from ..paper.rows import prism_geometry
from ..place import Place, resolve
from ..timing import Measured, Stages, measured, toucher
from ..timing import timed as run_once
from .cell import ABSENT, DONE, FAILED, USELESS, Cell, Row, grouped
from .decoders import Decoder, Shot, decoder, shoot
from .measures import measures
from .solvers import installed, solver

Clock = Callable[[Callable[[], Any]], Measured]

TINY = (48, 48)  # camera on which everything is compiled before anything is timed
LATTICE_LINES = 64


def check(cells: Sequence[Cell]) -> None:
    """InputError for unknown names in a cell, before any work."""
    for cell in cells:
        solver(cell.solver)
        decoder(cell.decoder)
    asked = ((cell.scene, cell.size, cell.dent, cell.shown) for cell in cells)
    for name, size, dent, shown in dict.fromkeys(asked):
        scene = resolve(name, size)
        if dent:
            dent_from_text(dent, scene)
        if shown != "exact":
            own_sequence(shown, scene.pattern.rows, scene.pattern.cols, resized=size is not None)


def absent_modules(cells: Iterable[Cell]) -> tuple[str, ...]:
    """Packages that the decoders and solvers of cells require and that are not installed."""
    asked = dict.fromkeys(
        module for cell in cells for module in (decoder(cell.decoder).module, solver(cell.solver).module)
    )
    return tuple(module for module in asked if module is not None and not installed(module))


def run_cells(cells: Iterable[Cell], *, timed: bool = True) -> Iterator[Row]:
    """Rows in the order of `grouped` cells; timed: memory and the best of several runs, else one run each. A
    failure becomes a row with its reason."""
    clock = measured if timed else run_once
    for _, sharing in groupby(grouped(cells), lambda group: group[0].place):
        place: Place | None = None
        for group in sharing:
            try:
                place = place or _place(group[0])
                shot = shoot(place, group[0])
            except InputError as error:
                yield from (Row(cell, USELESS, str(error)) for cell in group)
            else:
                yield from _of_shot(group, shot, clock)


def _place(cell: Cell) -> Place:
    """The mirror with the cell's faults of display and light, which do not affect the correspondence."""
    place = Place.of(cell.scene, cell.dent, cell.size)
    return replace(place, scene=cell.faults.on(place.scene))


def warm_up(cells: Iterable[Cell], told: Callable[[str, int, int], None]) -> None:
    """Compile all kernels of the cells, on a tiny camera."""
    tiny = list(dict.fromkeys(replace(cell, size=TINY, noise=1.0, seed=0) for cell in cells))
    for done, _ in enumerate(run_cells(tiny, timed=False)):
        told("warm-up", done, len(tiny))


def _of_shot(cells: Iterable[Cell], shot: Shot, clock: Clock) -> Iterator[Row]:
    """Rows of cells that use the same frames."""
    if shot.sequence is not None and shot.sequence.name == "lattice":
        yield from (_lattice(cell, shot.place) for cell in cells)
        return
    timings: dict[str, float] = {}
    if shot.frames is not None:
        toucher(shot.frames[:, :1].copy())()  # compiles, which is not part of the floor
        floor = clock(toucher(shot.frames)).seconds
        timings = {"render_seconds": shot.render_seconds, "floor_seconds": floor}
    for name, mine in groupby(cells, lambda cell: cell.decoder):
        yield from _decoded(list(mine), decoder(name), shot, timings, clock)


def _decoded(
    cells: list[Cell], coder: Decoder, shot: Shot, timings: dict[str, float], clock: Clock
) -> Iterator[Row]:
    """Rows of cells with the same decoder."""
    count, place = 0 if shot.sequence is None else len(shot.sequence), shot.place
    decoded = _tried(coder.module, lambda: _decode(coder, shot, clock))
    if isinstance(decoded, tuple):
        yield from (Row(cell, *decoded, coder.kind, count) for cell in cells)
        return
    seen: Correspondence = decoded.value
    timings = timings | ({"decode_seconds": 0.0} if coder.kind == "floor" else _timings("decode", decoded))
    for cell in cells:
        way = solver(cell.solver)
        kind = way.kind if coder.kind == "own" else coder.kind
        solved = _tried(way.module, partial(clock, partial(way.run, seen, place.scene)))
        if isinstance(solved, tuple):
            yield Row(cell, *solved, kind, count, timings)
        else:
            spent = timings | _timings("reconstruct", solved)
            yield Row(cell, DONE, "", kind, count, spent, measures(place.truth, seen, solved.value))


def _decode(coder: Decoder, shot: Shot, clock: Clock) -> Measured:
    alone = coder.clock
    if alone is None:
        return clock(lambda: coder.run(shot))
    seen = coder.run(shot)
    taken = clock(lambda: alone(shot))
    return replace(taken, value=seen, seconds=taken.seconds / coder.divide)


def _lattice(cell: Cell, place: Place) -> Row:
    """The paper's measurement: crossings of one lattice frame (and one at rest), the paper's recursion along
    the line through the middle. Errors are along that line, timings of single runs.
    """
    row = Row(cell, USELESS, "lattice crossings are sparse: method paper only", "paper", 1)
    if cell.solver != "paper":
        return row
    scene, surface, stages = place.scene, place.surface, Stages(3, silent)
    settings: dict[str, Any] = {"noise": cell.noise, "seed": cell.capture_seed, "renderer": cell.renderer}
    try:
        geometry = prism_geometry(scene)
        with stages.stage("render"):
            frames = lattice_frames(scene, surface, LATTICE_LINES, **settings)
        with stages.stage("decode"):
            found = lattice_positions(scene, *frames)
        points = seen_points(surface, geometry, *found)
        with stages.stage("reconstruct"):
            depth = recursion(points.m, points.w, geometry).mean.d
    except InputError as error:
        return replace(row, why=str(error))
    known = np.isfinite(depth) & np.isfinite(points.d)
    off, peak = np.abs(depth - points.d)[known], place.peak
    metrics = {
        "height_rms_rel": rms(off) / peak,
        "height_p95_rel": float(np.quantile(off, 0.95)) / peak,
        "height_max_rel": float(off.max()) / peak,
        "height_rms_mm": rms(off),
        "peak_depth_mm": peak,
        "flagged_share": 1.0 - float(known.mean()),
    }
    timings = {f"{name}_seconds": seconds for name, seconds in stages.seconds.items() if name != "total"}
    return replace(row, status=DONE, why="", timings=timings, metrics=metrics)


def _tried(module: str | None, stage: Callable[[], Measured]) -> Measured | tuple[str, str]:
    """Result of a stage, or a status with its reason: a failed cell must not end a run of hundreds. module:
    required package."""
    if not installed(module):
        return ABSENT, f"{module} is not installed"
    try:
        return stage()
    except InputError as error:
        return USELESS, str(error)
    except Exception as error:
        return FAILED, f"{type(error).__name__}: {error}"


def _timings(stage: str, taken: Measured) -> dict[str, float]:
    timings = {f"{stage}_seconds": taken.seconds}
    return timings if taken.bytes is None else timings | {f"{stage}_bytes": float(taken.bytes)}
