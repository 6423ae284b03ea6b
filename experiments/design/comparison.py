"""Speed against error: codes under one fault of display or light, predicted, simulated, and as a chart."""

from collections.abc import Sequence as Many
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from optolever.errors import InputError
from optolever.files import atomic_file, write_rows
from optolever.records import Progress, silent
from optolever.scene import Scene, dent_from_text

from ..faults import Faults
from ..images import label_axes, new_figure
from .candidates import Candidate, OwnCandidate
from .ranking import DesignRow, code_row
from .sensitivity import Lever

AXES = ("noise", "lag", "gamma", "flicker", "blur")


@dataclass(frozen=True, slots=True)
class CodePoint:
    """A code at one value of the axis; row: its predicted and simulated error, its seconds."""

    value: float
    row: DesignRow


def compare_codes(
    scene: Scene,
    codes: Many[Candidate | OwnCandidate],
    axis: str = "noise",
    values: Many[float] = (1.0,),
    *,
    dent: str | None = None,
    faults: Faults | None = None,
    noise: float = 1.0,
    refresh: float = 60.0,
    seeds: int = 3,
    renderer: str = "auto",
    progress: Progress = silent,
) -> list[CodePoint]:
    """Every code at every value of an axis: noise (rms, 8-bit levels), or a field of Faults.

    The frames are displayed in their order, under the same draws of noise for all. Seconds: of the display at
    `refresh` frames a second, and of one processor for decode and reconstruct. InputError: no such axis, a
    scene that sees no pattern.
    """
    if axis not in AXES:
        raise InputError(f"axis {axis!r}: unknown, must be one of {', '.join(AXES)}")
    points: list[CodePoint] = []
    for value in values:
        level = value if axis == "noise" else noise
        known = faults or Faults()
        known = known if axis == "noise" else replace(known, **{axis: value})
        place = known.on(scene)
        lever = Lever(place, dent_from_text(dent or scene.dent or "flat", place))
        for code in codes:
            progress(code.text, len(points), len(codes) * len(values))
            points.append(CodePoint(value, code_row(lever, code, level, refresh, known.lag, seeds, renderer)))
    return points


def save_points(path: str | Path, axis: str, points: Many[CodePoint]) -> None:
    """Write a CSV file: a row per point."""
    names = [field.name for field in fields(DesignRow)]
    rows = [[point.value, *(asdict(point.row)[name] for name in names)] for point in points]
    write_rows(path, [axis, *names], rows)


def draw_points(path: str | Path, axis: str, points: Many[CodePoint]) -> None:
    """Write a PNG file: error over both seconds, a line per code along the axis; crosses are predicted."""
    figure = new_figure(11.0, 4.6)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, name, label in zip(
        panels, ("cpu_seconds", "seconds"), ("decode and reconstruct [CPU s]", "display [s]"), strict=True
    ):
        for text in dict.fromkeys(point.row.text for point in points):
            mine = [point for point in points if point.row.text == text]
            times = [getattr(point.row, name) for point in mine]
            (line,) = axes.plot(times, [point.row.simulated for point in mine], "o-", label=text)
            axes.plot(times, [point.row.predicted for point in mine], "x", color=line.get_color())
            for point, time in zip(mine, times, strict=True):
                axes.annotate(f" {point.value:g}", (time, point.row.simulated), fontsize=7)
        axes.set(xscale="log", yscale="log")
        label_axes(axes, label, "rms height error [mm]" if axes is panels[0] else "", frame=True)
    panels[0].legend(fontsize=8, title=f"numbers: {axis}", title_fontsize=8)
    with atomic_file(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)
