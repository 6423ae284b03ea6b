"""`optolever paper`: the seed's simulation and experiment, by the seed's method and by the dense solver.

Every case is a scene and a dent, with exact data and with rendered, noisy 8-bit frames; every result is a row
of numbers along the line through the dent's middle, errors over the peak depth.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from optolever.decode import Correspondence, decode
from optolever.notices import Notice
from optolever.patterns import sequence
from optolever.projector import capture, chosen_renderer
from optolever.reconstruct import reconstruct
from optolever.records import Progress, silent
from optolever.scene import Scene, Surface

from ..arrays import Floats, Mask
from ..metrics import rms
from ..place import Dent, Place, exact, surface_of
from ..timing import Run, Stages, peak_bytes
from .line import (
    Line,
    PaperRow,
    Points,
    dense_row,
    lattice_frames,
    lattice_points,
    lattice_positions,
    paper_rows,
    pixel_points,
    seen_points,
)
from .rows import capture_positions, pattern_positions, reconstruct_paper


@dataclass(frozen=True, slots=True)
class Case:
    """One of the seed's mirrors: scene, dent (None: the scene's own) and the number of lattice lines.

    rendered: in three dimensions, with frames and the dense solver, not only the two-dimensional simulation.
    """

    name: str
    scene: str
    dent: Dent
    lines: int
    rendered: bool = True


def tent(scene: Scene) -> Surface:
    """A wedge as wide as the mirror, 13 of 1637 deep in its middle: an alternative model of the seed's
    needle."""
    half = scene.mirror.length / 2
    slope = 13 / 1637 * scene.mirror.length / half

    def form(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        return slope * (half - np.abs(x - half)) + 0 * y, -slope * np.sign(x - half) + 0 * y, 0 * (x + y)

    return surface_of(form)


CASES = (
    Case("smooth", "paper-simulation", "raised-cosine", 64),
    Case("needle", "paper-simulation", "needle", 64),
    Case("tent", "paper-simulation", tent, 64, rendered=False),
    Case("pencil", "paper-prototype", None, 16),
)


@dataclass(frozen=True)
class PaperStudy(Run):
    """The rows of all cases."""

    rows: list[PaperRow]

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices of all rows, without duplicates."""
        return tuple(dict.fromkeys(notice for row in self.rows for notice in row.notices))

    def find(self, **fields: Any) -> PaperRow:
        """The row with these fields."""
        return next(row for row in self.rows if all(getattr(row, k) == v for k, v in fields.items()))

    def to_dict(self) -> dict[str, Any]:
        """The numbers as plain values: rows, seconds, peak_bytes, settings."""
        return {"rows": [row.to_dict() for row in self.rows], **self.run_dict()}


@dataclass(frozen=True, slots=True)
class Setup:
    """A traced case: its mirror, and the largest depth along the line through the middle, mm."""

    case: Case
    place: Place
    line: Line
    peak: float

    @classmethod
    def of(cls, case: Case, size: tuple[int, int] | None) -> "Setup":
        """The case's scene and dent, traced."""
        place = Place.of(case.scene, case.dent, size)
        line, x = Line.of(place), np.linspace(0, place.scene.mirror.length, 4001)
        return cls(case, place, line, float(np.max(place.surface.height(x, np.full_like(x, line.y)))))

    @property
    def row(self) -> int:
        """The camera's middle row."""
        return self.place.scene.camera.rows // 2

    def middle(self, seen: Correspondence) -> Points:
        """Measured points of the middle row, from l = 0 on, with the truth; NaN where flagged."""
        row, truth = self.row, self.place.truth
        x, y = truth.x[row], truth.y[row]
        theta = np.arctan(np.asarray(self.place.surface.gradient(x, y)[0], dtype=np.float64))
        m = np.where(seen.good[row], pattern_positions(self.place.scene, seen.u[row]), np.nan)
        w = capture_positions(self.place.scene, row, np.arange(x.size, dtype=np.float64))
        return Points(*(field[::-1] for field in (m, w, x, truth.z[row], theta)))


def run_paper(
    *,
    noise: float = 1.0,
    seed: int = 0,
    size: tuple[int, int] | None = None,
    renderer: str = "auto",
    progress: Progress = silent,
) -> PaperStudy:
    """Repeat the seed's simulation and experiment geometry; size (rows, cols) resamples the camera of every
    case.
    """
    stages = Stages(sum(5 if case.rendered else 2 for case in CASES), progress)
    shot: dict[str, Any] = {"noise": noise, "seed": seed, "renderer": chosen_renderer(renderer)}
    rows: list[PaperRow] = []
    taken: dict[str, Any] = {}
    for case in CASES:
        with stages.stage(f"{case.name}: trace"):
            setup = Setup.of(case, size)
        with stages.stage(f"{case.name}: the seed's simulation"):
            rows += _simulated(setup)
        if case.rendered:
            with stages.stage(f"{case.name}: exact correspondence"):
                rows += _on_pixels(setup, exact(setup.place.truth), "exact")
            with stages.stage(f"{case.name}: lattice frames"):
                rows += _on_lattice(setup, **shot)
            with stages.stage(f"{case.name}: sequence frames"):
                rows += _on_pixels(setup, _decoded(setup, **shot), "frames")
        taken[case.name] = {
            "scene": case.scene,
            "size": [setup.place.scene.camera.rows, setup.place.scene.camera.cols],
            "dent": setup.place.dent,
            "peak_mm": setup.peak,
            "length_mm": setup.line.geometry.length,
            "lines": case.lines,
        }
    return PaperStudy(
        rows=rows,
        seconds=stages.seconds,
        peak_bytes=peak_bytes(),
        settings={"cases": taken, "size": size, **shot},
    )


def _decoded(setup: Setup, **settings: Any) -> Correspondence:
    scene = setup.place.scene
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    return decode(capture(scene, setup.place.surface, shown, **settings).frames, shown)


def _simulated(setup: Setup) -> Iterator[PaperRow]:
    """The seed's two-dimensional simulation: lattice lines and a line of pixels, by both laws."""
    case, line, scene = setup.case, setup.line, setup.place.scene
    w = capture_positions(scene, setup.row, np.arange(scene.camera.cols, dtype=np.float64))
    for law, forward, signs in (("reflection", 1, (1, -1)), ("print", -1, (-1,))):
        measured = {"lattice": lattice_points(line, case.lines, forward)}
        if forward == -1 or not case.rendered:  # else the traced scene has them
            measured["pixels"] = pixel_points(line, w, forward)
        for method, points in measured.items():
            yield from paper_rows(points, line.geometry, setup.peak, (case.name, "exact", law, method), signs)


def _on_lattice(setup: Setup, **settings: Any) -> Iterator[PaperRow]:
    """One column of lattice crossings from a rendered rest frame and a rendered dented frame."""
    scene, surface, geometry = setup.place.scene, setup.place.surface, setup.line.geometry
    frames = lattice_frames(scene, surface, setup.case.lines, **settings)
    points = seen_points(surface, geometry, *lattice_positions(scene, *frames))
    yield from paper_rows(points, geometry, setup.peak, (setup.case.name, "frames", "reflection", "lattice"))


def _on_pixels(setup: Setup, seen: Correspondence, data: str) -> Iterator[PaperRow]:
    """The paper's method on every pixel, and the dense solver."""
    middle, names = setup.middle(seen), (setup.case.name, data, "reflection")
    for row in paper_rows(middle, setup.line.geometry, setup.peak, (*names, "pixels")):
        if (row.sign, row.gamma) == (1, True):
            whole = reconstruct_paper(seen, setup.place.scene, series="drops")
            yield replace(row, field=_field(setup, whole.z, whole.good))
        else:
            yield row
    dense = reconstruct(seen, setup.place.scene)
    found = dense_row(middle, dense, setup.row, setup.peak, (*names, "dense"))
    yield replace(found, field=_field(setup, dense.z, dense.good), notices=dense.notices)


def _field(setup: Setup, z: Floats, good: Mask) -> float:
    """Rms error over all good pixels, over the peak depth."""
    use = good & setup.place.truth.visible
    return rms(z[use] - setup.place.truth.z[use]) / setup.peak
