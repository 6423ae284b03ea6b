"""Cells to rows: frames once for all that take them, decoded once, then every solver."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.patterns import sequence_from_text
from optolever.projector import Capture
from optolever.reconstruct import prism_geometry, recursion
from optolever.scene import dent_from_text, load

from ..decode_speed import toucher
from ..metrics import rms
from ..paper_frames import lattice_frames, lattice_positions
from ..paper_simulation import seen_points
from ..place import Place
from ..timing import Measured, measured, once
from .cell import Cell, grouped
from .decoders import Decoder, decoder
from .measures import measures
from .row import ABSENT, DONE, FAILED, USELESS, Row
from .shot import Shot, place_of, shoot
from .solvers import Solver, installed, solver

__all__ = ["Bench", "absent_modules", "check", "run_cells", "warm_up"]

TINY = (48, 48)  # camera on which everything is compiled before anything is timed
LATTICE_PIXELS = 10  # camera pixels that a lattice line needs, as in the paper's study
LATTICE_LINES = 64


def check(cells: Sequence[Cell]) -> None:
    """InputError if a cell names what does not exist: known before the work."""
    for cell in cells:
        solver(cell.solver)
        decoder(cell.decoder)
    for name, dent, shown in dict.fromkeys((cell.scene, cell.dent, cell.shown) for cell in cells):
        scene = load(name)
        if dent:
            dent_from_text(dent, scene)
        if shown != "exact":
            sequence_from_text(shown, scene.pattern.rows, scene.pattern.cols)


def absent_modules(cells: Iterable[Cell]) -> tuple[str, ...]:
    """Packages that the decoders and solvers of cells ask for, and that are not installed."""
    asked = dict.fromkeys(
        module for cell in cells for module in (decoder(cell.decoder).module, solver(cell.solver).module)
    )
    return tuple(module for module in asked if module is not None and not installed(module))


def run_cells(cells: Iterable[Cell], *, timed: bool = True) -> Iterator[Row]:
    """Rows in the order of `grouped` cells; timed: memory and the best of several runs, else one each."""
    bench = Bench(timed)
    for group in grouped(cells):
        yield from bench.group(group)


def warm_up(cells: Iterable[Cell], told: Callable[[str, int, int], None]) -> None:
    """Compile everything that the cells will use, on a tiny camera."""
    tiny = list(dict.fromkeys(replace(cell, size=TINY, noise=1.0, seed=0) for cell in cells))
    groups = grouped(tiny)
    bench = Bench(False)
    for done, group in enumerate(groups):
        told("warm-up", done, len(groups))
        list(bench.group(group))


class Bench:
    """Runs groups of cells; remembers the last mirror, since neighbours in a grid share it."""

    def __init__(self, timed: bool) -> None:
        self._clock: Callable[[Callable[[], Any]], Measured] = measured if timed else once
        self._key: tuple[Any, ...] | None = None
        self._place: Place | None = None
        self._touched: tuple[Capture, float] | None = None

    def group(self, cells: tuple[Cell, ...]) -> Iterator[Row]:
        """Rows of cells that take the same frames. What goes wrong becomes a row that says so."""
        first = cells[0]
        try:
            shot = shoot(self._at(first), first)
        except InputError as error:
            yield from (Row(cell, USELESS, str(error)) for cell in cells)
            return
        for name in dict.fromkeys(cell.decoder for cell in cells):
            mine = [cell for cell in cells if cell.decoder == name]
            if shot.sequence is not None and shot.sequence.name == "lattice":
                yield from (self._lattice(cell, shot) for cell in mine)
            else:
                yield from self._decoded(mine, shot)

    def _at(self, cell: Cell) -> Place:
        if self._place is None or self._key != cell.place:
            self._key, self._place = cell.place, place_of(cell)
        return self._place

    def _decoded(self, cells: list[Cell], shot: Shot) -> Iterator[Row]:
        """Rows of cells with the same decoder."""
        coder = decoder(cells[0].decoder)
        blank = Row(cells[0], ABSENT, "", coder.kind, shot.count)
        if not installed(coder.module):
            blank = replace(blank, why=f"{coder.module} is not installed")
            yield from (replace(blank, cell=cell) for cell in cells)
            return
        timings: dict[str, float] = {}
        if shot.capture is not None:
            timings["render_seconds"] = shot.render_seconds
            timings["floor_seconds"] = self._floor(shot.capture)
        blank, decoded = _tried(blank, lambda: self._decode(coder, shot))
        if decoded is None:
            yield from (replace(blank, cell=cell) for cell in cells)
            return
        timings |= {"decode_seconds": 0.0} if coder.kind == "floor" else _timings("decode", decoded)
        for cell in cells:
            row = replace(blank, cell=cell, timings=timings)
            yield self._solved(row, solver(cell.solver), decoded.value, shot.place)

    def _floor(self, taken: Capture) -> float:
        """Seconds that only reading the frames and writing a decoder's output takes, once per shot."""
        if self._touched is None or self._touched[0] is not taken:
            toucher(taken.frames[:, :1].copy())()  # compiles, which is not part of the floor
            self._touched = taken, self._clock(toucher(taken.frames)).seconds
        return self._touched[1]

    def _decode(self, coder: Decoder, shot: Shot) -> Measured:
        if coder.clock is None:
            return self._clock(lambda: coder.run(shot))
        clock = coder.clock
        seen = coder.run(shot)
        taken = self._clock(lambda: clock(shot))
        return Measured(seen, taken.seconds / coder.divide, taken.bytes)

    def _solved(self, row: Row, way: Solver, seen: Correspondence, place: Place) -> Row:
        row = replace(row, kind=way.kind if row.kind == "own" else row.kind)
        if not installed(way.module):
            return replace(row, status=ABSENT, why=f"{way.module} is not installed")
        row, solved = _tried(row, lambda: self._clock(lambda: way.run(seen, place.scene)))
        if solved is None:
            return row
        return replace(
            row,
            status=DONE,
            timings=row.timings | _timings("reconstruct", solved),
            metrics=measures(place.truth, seen, solved.value),
        )

    def _lattice(self, cell: Cell, shot: Shot) -> Row:
        """The paper's own measurement: crossings of one lattice frame (and one at rest), its recursion along
        the line through the middle. Errors are along that line.
        """
        row = Row(cell, USELESS, "lattice crossings are sparse: method paper only", "paper", 1)
        if cell.solver != "paper":
            return row
        try:
            return _paper_line(row, shot.place)
        except InputError as error:
            return replace(row, why=str(error))


def _tried(row: Row, stage: Callable[[], Measured]) -> tuple[Row, Measured | None]:
    """What a stage gives, or the row that says what went wrong: one bad cell must not end a run of
    hundreds."""
    try:
        return row, stage()
    except InputError as error:
        return replace(row, status=USELESS, why=str(error)), None
    except Exception as error:
        return replace(row, status=FAILED, why=f"{type(error).__name__}: {error}"), None


def _timings(stage: str, taken: Measured) -> dict[str, float]:
    timings = {f"{stage}_seconds": taken.seconds}
    return timings if taken.bytes is None else timings | {f"{stage}_bytes": float(taken.bytes)}


def _paper_line(row: Row, place: Place) -> Row:
    """The row with timings (of single runs) and metrics of the paper's measurement."""
    cell = row.cell
    scene, geometry = place.scene, prism_geometry(place.scene)
    lines = min(LATTICE_LINES, scene.camera.cols // LATTICE_PIXELS)
    settings: dict[str, Any] = {"noise": cell.noise, "seed": cell.capture_seed, "renderer": cell.renderer}
    taken = once(lambda: lattice_frames(scene, place.surface, lines, **settings))
    found = once(lambda: lattice_positions(scene, *taken.value))
    m, w, y = found.value
    points = seen_points(place.surface, geometry, m, w, y)
    solved = once(lambda: recursion(points.m, points.w, geometry).mean.d)
    known = np.isfinite(solved.value) & np.isfinite(points.d)
    error = np.abs(solved.value - points.d)[known]
    peak = place.peak
    stages = (("render", taken), ("decode", found), ("reconstruct", solved))
    return replace(
        row,
        status=DONE,
        why="",
        timings={f"{name}_seconds": stage.seconds for name, stage in stages},
        metrics={
            "height_rms_rel": rms(error) / peak,
            "height_p95_rel": float(np.quantile(error, 0.95)) / peak,
            "height_max_rel": float(error.max()) / peak,
            "height_rms_mm": rms(error),
            "peak_depth_mm": peak,
            "flagged_share": 1.0 - float(known.mean()),
        },
    )
