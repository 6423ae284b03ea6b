"""The pages of a demo run and of saved records: height, error bars, flags, correspondence, frames; the prose
is in report/demo.html and report/record.html.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np

from optolever.decode import Correspondence
from optolever.projector import Capture
from optolever.reconstruct import HeightMap, budget

from .demo import DemoResult
from .demo_inputs import correspondence_picture, flags_table, frame_pairs
from .height_view import HeightView
from .page import budget_table, embedded_json, write_page

__all__ = ["write_demo_report", "write_record_report"]


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
    rows, flags_map = flags_table(view.height)
    pictures = {"flags": flags_map, "correspondence": "" if seen is None else correspondence_picture(seen)}
    return {
        "pictures": view.pictures() | pictures,
        "surface": surface,
        "surface_json": embedded_json(surface),
        "flags": rows,
        "notices": view.height.notices,
        "frames": [] if capture is None else frame_pairs(capture),
    }
