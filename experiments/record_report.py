"""The report of saved records: height, error bars, flags; correspondence and frames where they are given."""

import shlex
import time
from pathlib import Path

import numpy as np

from optolever.decode import Correspondence
from optolever.projector import Capture
from optolever.reconstruct import HeightMap, budget

from .demo_inputs import correspondence_picture, flags_table, frame_pairs
from .images import robust_limits
from .maps import MirrorGrid, Panel, length_unit, mirror_figure
from .metrics import peak_bytes
from .page import budget_table, embedded_json, render_page, stage_bars, write_page
from .surface_view import surface_data

__all__ = ["record_html", "write_record_report"]


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


def record_html(
    height: HeightMap,
    correspondence: Correspondence | None = None,
    capture: Capture | None = None,
    command: tuple[str, ...] = (),
    less: HeightMap | None = None,
) -> str:
    """The whole page."""
    start = time.perf_counter()
    good = height.good
    z, sigma = (np.where(good, one, np.nan) for one in (height.z, height.total_sigma))
    grid = MirrorGrid.around(np.where(np.isfinite(z), height.x, np.nan), height.y)
    middle = float(np.median(sigma[good])) if good.any() else float("nan")
    factor, unit = length_unit(middle)
    layers = {"height": (z, "mm", "viridis", False), "sigma": (sigma * factor, unit, "cividis", False)}
    surface = surface_data(height.x, height.y, z, layers)
    rows, flags_map = flags_table(height)
    title = "Measured height z, positive into the medium"
    deep = Panel(grid.place(z), title, "z [mm]", limits=robust_limits(z, 0.9999))
    bars = Panel(grid.place(sigma * factor), "Sigma of the height", f"sigma [{unit}]", "cividis")
    context = {
        "source": command[2] if len(command) > 2 else "a height map",
        "size": height.z.shape,
        "good_share": float(good.mean()),
        "deepest": float(z[good].max()) if good.any() else float("nan"),
        "least": float(z[good].min()) if good.any() else float("nan"),
        "sigma": middle,
        "pictures": {
            "height": mirror_figure([deep], grid),
            "sigma": mirror_figure([bars], grid),
            "flags": flags_map,
            "correspondence": "" if correspondence is None else correspondence_picture(correspondence),
        },
        "budget": budget_table(budget(height, less)),
        "surface": surface,
        "surface_json": embedded_json(surface),
        "flags": rows,
        "notices": height.notices,
        "frames": [] if capture is None else frame_pairs(capture),
        "command": shlex.join(command),
        "memory_gib": peak_bytes() / 2**30,
    }
    seconds = time.perf_counter() - start
    return render_page("record.html", {**context, "stages": stage_bars({"report": seconds})})
