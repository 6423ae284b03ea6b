"""The report of a demo run: headline numbers, every record of the chain; the prose is in report/demo.html."""

import shlex
import time
from pathlib import Path
from typing import Any

from .demo import DemoResult
from .demo_inputs import correspondence_picture, flags_table, frame_pairs
from .demo_pictures import HeightView
from .page import embedded_json, render_page, stage_bars, write_page

__all__ = ["demo_html", "write_demo_report"]


def write_demo_report(result: DemoResult, path: str | Path) -> DemoResult:
    """Write the page and return the run with the time that this took.

    The page's own timing ends where its pictures are drawn.
    """
    start = time.perf_counter()
    result = result.with_contacts()
    write_page(path, demo_html(result))
    return result.with_report(time.perf_counter() - start)


def demo_html(result: DemoResult) -> str:
    """The whole page."""
    start = time.perf_counter()
    view = HeightView.of(result)
    surface = view.surface()
    rows, flags_map = flags_table(result.height)
    pictures = {
        "height": view.height_map(),
        "profile": view.profile(),
        "error": view.error_map(),
        "histograms": view.histograms(),
        "reliability": view.reliability(),
        "sigma": view.sigma_map(),
        "flags": flags_map,
        "correspondence": correspondence_picture(result.correspondence),
    }
    frames = frame_pairs(result.capture)
    timed = result.with_report(time.perf_counter() - start)
    context = {
        "asked": result.settings,
        "m": result.metrics,
        "pictures": pictures,
        "surface": surface,
        "surface_json": embedded_json(surface),
        "flags": rows,
        "notices": result.height.notices,
        "contacts": result.contacts,
        "visible_share": float(result.truth.visible.mean()),
        "frames": frames,
        "stages": stage_bars(timed.seconds),
        "total_seconds": timed.seconds["total"],
        "memory_gib": timed.peak_bytes / 2**30,
        "command": demo_command(result.settings),
    }
    return render_page("demo.html", context)


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
