"""The pages of a demo run and of saved records: height, error bars, flags, correspondence, frames; the prose
is in report/demo.html and report/record.html.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.patterns import Frame
from optolever.projector import Capture
from optolever.reconstruct import HeightMap, budget

from .demo import DemoResult
from .flag_words import FlagRow, flag_index, flag_rows
from .height_view import HeightView
from .images import png_uri, robust_limits, thumbnail
from .maps import Panel, camera_figure, flags_figure
from .page import budget_table, embedded_json, write_page

__all__ = ["write_demo_report", "write_record_report"]

Array = NDArray[np.float64]
THUMBNAIL = 150  # pixels


def write_demo_report(result: DemoResult, path: str | Path) -> DemoResult:
    """Write the page and return the run with the time that this took.

    The page's own timing ends where its pictures are drawn.
    """
    start = time.perf_counter()
    result = result.with_contacts()
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
    known = [values[height.good] for values in (height.z, height.total_sigma)]
    z, sigma = (values if values.size else np.array([np.nan]) for values in known)
    context |= {
        "source": source,
        "size": height.z.shape,
        "good_share": float(height.good.mean()),
        "deepest": float(z.max()),
        "least": float(z.min()),
        "sigma": float(np.median(sigma)),
        "budget": budget_table(budget(height, less)),
    }
    write_page(path, "record.html", {"report": time.perf_counter() - start}, context)


def _common(view: HeightView, capture: Capture | None) -> dict[str, Any]:
    """What both pages show."""
    seen, surface = view.correspondence, view.surface()
    rows, flags_map = _flags_table(view.height)
    pictures = {"flags": flags_map, "correspondence": "" if seen is None else _correspondence_picture(seen)}
    return {
        "pictures": view.pictures() | pictures,
        "surface": surface,
        "surface_json": embedded_json(surface),
        "flags": rows,
        "notices": view.height.notices,
        "frames": [] if capture is None else _frame_pairs(capture),
    }


def _flags_table(height: HeightMap) -> tuple[list[FlagRow], str]:
    """Counts of every reason, and a map of them as the camera sees it."""
    flags = np.asarray(height.flags)
    rows = flag_rows(flags)
    return rows, flags_figure(flag_index(flags, rows), [row.colour for row in rows])


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


def _best_plane(values: Array) -> Array:
    """The least-squares plane through the finite values, on every pixel."""
    row, col = np.meshgrid(*(np.linspace(-1, 1, n) for n in values.shape), indexing="ij")
    use = np.isfinite(values)
    if not use.any():
        return np.zeros(values.shape)
    basis = np.stack([np.ones(int(use.sum())), row[use], col[use]])
    a, b, c = np.linalg.lstsq(basis @ basis.T, basis @ values[use], rcond=None)[0]
    return np.asarray(a + b * row + c * col, dtype=np.float64)
