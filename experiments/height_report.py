"""The pages of a demo run and of saved records: height, error bars, flags, correspondence, frames; the prose
is in report/demo.html and report/record.html.
"""

import itertools
import time
from dataclasses import dataclass, replace
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag
from optolever.patterns import Frame
from optolever.projector import Capture
from optolever.reconstruct import HeightFlag, HeightMap, budget, contacts, slope_map

from .arrays import Floats
from .demo import DemoResult
from .height_view import HeightView
from .images import Panel, camera_figure, flags_figure, png_uri, robust_limits, thumbnail
from .page import budget_table, embedded_json, write_page

GOOD_COLOUR = "#dfe5ea"
MEANING = {
    "DARK": "too little light came back, for instance where total reflection is lost",
    "SATURATED": "the camera was at its upper limit",
    "LOW_CONTRAST": "the pattern is too weak in this pixel to be decoded",
    "ORDER_DOUBTFUL": "which fringe it is cannot be told with certainty",
    "OFF_PATTERN": "the pixel looks beside the pattern surface",
    "OUTLIER": "the coordinate does not fit its neighbours",
    "MOVED": "the mirror moved while the frames were taken",
    "INVALID": "no data came in for this pixel",
    "WRONG_FRAME": "frames were lost, shown twice, torn or in each other's place",
    "NO_ANCHOR": "an island whose absolute height nothing fixes",
    "CURL": "the slopes contradict each other around this pixel",
    "STEEP": "steeper than the optical lever can measure",
    "NOT_CONVERGED": "the solver found no answer here",
    "SINGULAR": "the pattern lies within its noise of the mirror: no slope can be told",
    "IMPLAUSIBLE": "the capture contradicts its scene: no rig of the scene's accuracy can have taken it",
}
COLOURS = [to_hex(colour) for colour in colormaps["tab20"].colors]  # type: ignore[attr-defined]
THUMBNAIL = 150  # pixels


@dataclass(frozen=True, slots=True)
class FlagRow:
    """One reason: how many pixels carry it (a pixel may carry several) and what it means."""

    name: str
    bit: int
    count: int
    share: float
    meaning: str
    colour: str


def flag_rows(flags: NDArray[np.integer]) -> list[FlagRow]:
    """The reasons that occur in a flag field, after a row for the pixels without any."""
    good, size = int((flags == 0).sum()), max(flags.size, 1)
    rows = [FlagRow("good", 0, good, good / size, "the number and its sigma stand", GOOD_COLOUR)]
    members: list[IntFlag] = [*Flag, *HeightFlag]
    for member, colour in zip(members, itertools.cycle(COLOURS), strict=False):
        count, name = int(((flags & int(member)) != 0).sum()), str(member.name)
        if count:
            words = name.lower().replace("_", " ")
            rows.append(FlagRow(words, int(member), count, count / size, MEANING[name], colour))
    return rows


def flag_index(flags: NDArray[np.integer], rows: list[FlagRow]) -> NDArray[np.int8]:
    """Which of `rows` colours each pixel: the first of its reasons, row 0 where it has none."""
    index = np.zeros(flags.shape, dtype=np.int8)
    for place in range(len(rows) - 1, 0, -1):
        index[(flags & rows[place].bit) != 0] = place
    return index


def write_demo_report(result: DemoResult, path: str | Path) -> DemoResult:
    """Write the page and return the run with the time that this took.

    The page's own timing ends where its pictures are drawn.
    """
    start = time.perf_counter()
    slopes = slope_map(result.height, result.correspondence, result.scene)
    result = replace(result, contacts=contacts(result.height, slopes))
    view = HeightView.of(result.height, result.correspondence, result.truth)
    context = _common(view, result.capture)
    context["pictures"] |= view.compared(result.correspondence, result.truth)
    seconds = result.with_report(time.perf_counter() - start).seconds
    context |= {
        "asked": result.settings,
        "m": result.metrics,
        "contacts": result.contacts,
        "visible_share": float(result.truth.visible.mean()),
        "total_seconds": seconds["total"],
    }
    write_page(path, "demo.html", seconds, context)
    return result.with_report(time.perf_counter() - start)


def write_record_report(
    path: str | Path,
    height: HeightMap,
    correspondence: Correspondence | None = None,
    capture: Capture | None = None,
    source: str = "a height map",
    less: HeightMap | None = None,
) -> None:
    """Write the page; source: where the map is from; less: a map of the same rig, for the uncertainty of the
    difference."""
    start = time.perf_counter()
    view = HeightView.of(height, correspondence)
    context = _common(view, capture)
    known = [values[height.good] for values in (height.z, height.sigma, height.calibration_sigma)]
    z, noise, rig = (values if values.size else np.array([np.nan]) for values in known)
    context |= {
        "source": source,
        "size": height.z.shape,
        "good_share": float(height.good.mean()),
        "deepest": float(z.max()),
        "least": float(z.min()),
        "noise": float(np.median(noise)),
        "rig": None if height.calibration is None else float(np.median(rig)),
        "budget": budget_table(budget(height, less)),
    }
    write_page(path, "record.html", {"report": time.perf_counter() - start}, context)


def _common(view: HeightView, capture: Capture | None) -> dict[str, Any]:
    """What both pages show."""
    seen, surface = view.correspondence, view.surface()
    flags = np.asarray(view.height.flags)
    rows = flag_rows(flags)
    flags_map = flags_figure(flag_index(flags, rows), [row.colour for row in rows])
    pictures = {"flags": flags_map, "correspondence": "" if seen is None else _correspondence_picture(seen)}
    return {
        "pictures": view.pictures() | pictures,
        "surface": surface,
        "surface_json": embedded_json(surface),
        "flags": rows,
        "notices": view.height.notices,
        "frames": [] if capture is None else _frame_pairs(capture),
    }


def _correspondence_picture(seen: Correspondence) -> str:
    """Maps of u and v, and of what is left of them without their best plane: the lever's deflection."""
    panels = []
    for letter, values, what in (("u", seen.u, "pattern column"), ("v", seen.v, "pattern row")):
        known = np.where(seen.good, values, np.nan)
        bent = known - _best_plane(known)
        limits = robust_limits(bent, symmetric=True)
        panels.append(Panel(known, f"{letter}: {what}", f"{letter} [px]"))
        panels.append(Panel(bent, f"{letter} minus its best plane", "deflection [px]", "RdBu_r", limits))
    return camera_figure(panels)


def _frame_pairs(capture: Capture) -> list[dict[str, str]]:
    """Every frame as it was shown and as the camera saw it, in small, with a few words."""
    return [
        {
            "shown": png_uri(thumbnail(capture.sequence.render_frame(index), THUMBNAIL)),
            "seen": png_uri(thumbnail(capture.frames[index], THUMBNAIL)),
            "name": f"{index + 1}. {_frame_words(frame)}",
        }
        for index, frame in enumerate(capture.sequence.frames)
    ]


def _frame_words(frame: Frame) -> str:
    """A frame in a few words."""
    words = [frame.kind if frame.axis is None else f"{frame.kind} on {frame.axis}"]
    if frame.bit is not None:
        words.append(f"bit {frame.bit}")
    if frame.inverted:
        words.append("inverted")
    if frame.period_px is not None:
        words.append(f"period {frame.period_px:.4g} px")
    if frame.shift is not None:
        words.append(f"shift {np.degrees(frame.shift):.0f}°")
    return ", ".join(words)


def _best_plane(values: Floats) -> Floats:
    """The least-squares plane through the finite values, on every pixel."""
    row, col = np.meshgrid(*(np.linspace(-1, 1, n) for n in values.shape), indexing="ij")
    use = np.isfinite(values)
    if not use.any():
        return np.zeros(values.shape)
    basis = np.stack([np.ones(int(use.sum())), row[use], col[use]])
    a, b, c = np.linalg.lstsq(basis @ basis.T, basis @ values[use], rcond=None)[0]
    return np.asarray(a + b * row + c * col, dtype=np.float64)
