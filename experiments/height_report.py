"""The pages of a demo run and of saved records: height, error bars, flags, correspondence, frames; the prose
is in report/demo.html and report/record.html.
"""

import shlex
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
from .metrics import peak_bytes
from .page import budget_table, embedded_json, render_page, stage_bars, write_page

__all__ = ["demo_html", "record_html", "write_demo_report", "write_record_report"]


def write_demo_report(result: DemoResult, path: str | Path) -> DemoResult:
    """Write the page and return the run with the time that this took.

    The page's own timing ends where its pictures are drawn.
    """
    start = time.perf_counter()
    result = result.with_contacts()
    write_page(path, demo_html(result))
    return result.with_report(time.perf_counter() - start)


def write_record_report(
    path: str | Path,
    height: HeightMap,
    correspondence: Correspondence | None = None,
    capture: Capture | None = None,
    command: tuple[str, ...] = (),
    less: HeightMap | None = None,
) -> None:
    """Write the page; command: the words that repeat it, of which the third names what is reported; less: a
    map of the same rig, for the uncertainty of the difference."""
    write_page(path, record_html(height, correspondence, capture, command, less))


def demo_html(result: DemoResult) -> str:
    """The whole page."""
    start = time.perf_counter()
    view = HeightView.of(result.height, result.correspondence, result.truth)
    context = _common(view, result.capture)
    context["pictures"] |= view.compared(result.correspondence, result.truth)
    timed = result.with_report(time.perf_counter() - start)
    context |= {
        "asked": result.settings,
        "m": result.metrics,
        "contacts": result.contacts,
        "visible_share": float(result.truth.visible.mean()),
        "stages": stage_bars(timed.seconds),
        "total_seconds": timed.seconds["total"],
        "memory_gib": timed.peak_bytes / 2**30,
        "command": demo_command(result.settings),
    }
    return render_page("demo.html", context)


def record_html(
    height: HeightMap,
    correspondence: Correspondence | None = None,
    capture: Capture | None = None,
    command: tuple[str, ...] = (),
    less: HeightMap | None = None,
) -> str:
    """The whole page."""
    start = time.perf_counter()
    view = HeightView.of(height, correspondence)
    context = _common(view, capture)
    known = [values[height.good] for values in (height.z, height.total_sigma)]
    z, sigma = (values if values.size else np.array([np.nan]) for values in known)
    context |= {
        "source": command[2] if len(command) > 2 else "a height map",
        "size": height.z.shape,
        "good_share": float(height.good.mean()),
        "deepest": float(z.max()),
        "least": float(z.min()),
        "sigma": float(np.median(sigma)),
        "budget": budget_table(budget(height, less)),
        "command": shlex.join(command),
        "memory_gib": peak_bytes() / 2**30,
        "stages": stage_bars({"report": time.perf_counter() - start}),
    }
    return render_page("record.html", context)


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


def demo_command(asked: dict[str, Any]) -> str:
    """The command line that repeats the run."""
    rows, cols = asked["size"]
    words = ["optolever", "demo"]
    for name in ("scene", "dent", "sequence"):
        words += [f"--{name}", str(asked[name])]
    words += ["--size", f"{rows}x{cols}", "--noise", f"{asked['noise']:g}", "--seed", str(asked["seed"])]
    words += ["--blur", f"{asked['blur_px']:g}", "--renderer", asked["renderer"]]
    if asked["anchor"] is not None:
        words += ["--anchor", asked["anchor"]]
    return shlex.join(words)
