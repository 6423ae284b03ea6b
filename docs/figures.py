"""All figures of the pages, from the program's own output: `python docs/figures.py FILE.png`.

The README's picture is committed (docs/readme.png).
"""

import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import rig_figures
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from optolever.decode import Correspondence, decode
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.reconstruct import Grid, reconstruct
from optolever.scene import Scene, Trace, dent_from_text, load, resize, trace

Floats = NDArray[np.float64]


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, inches."""
    figure = Figure((width, height), dpi=100, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def measured(rig: Scene, dent: str, noise: float = 1.0) -> tuple[NDArray[np.uint8], Correspondence, Trace]:
    """Frames of gray+phase, what decode makes of them, the truth."""
    shown = sequence("gray+phase", rig.pattern.rows, rig.pattern.cols)
    surface = dent_from_text(dent, rig)
    frames = capture(rig, surface, shown, noise=noise, seed=1).frames
    return frames, decode(frames, shown), trace(rig, surface)


def mirror_map(axes: Axes, grid: Grid, values: Floats, title: str, label: str, **style: Any) -> None:
    """Values on a height map's regular grid, mm, y up."""
    rows, cols = values.shape
    half = 0.5 * grid.pitch
    left, low = grid.x0 - half, grid.y0 - half
    extent = (left, left + cols * grid.pitch, low, low + rows * grid.pitch)
    image = axes.imshow(values, extent=extent, origin="lower", interpolation="nearest", **style)
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    cast(Figure, axes.figure).colorbar(image, ax=axes, label=label, shrink=0.85)


def readme(path: Path) -> None:
    """Rig, one frame, height and its sigma: prism48, a dent of 0.3 mm, noise of one grey level."""
    rig = resize(load("prism48"), 300, 400)
    frames, seen, _ = measured(rig, "gaussian:peak=0.3,sigma=6,x=24,y=20")
    grid = reconstruct(seen, rig).resample()
    figure = new_figure(9.6, 5.8)
    side, frame, map_z, map_sigma = figure.subplots(2, 2).flat
    rig_figures.rig(side, load("prism48"), dent="gaussian:peak=0.3,sigma=6,x=24,y=22")
    rig_figures.names(side, rig)
    side.set_ylim(-5, None)
    side.set_title("Rig: one camera row, ray by ray", fontsize=10, loc="left")
    frame.imshow(frames[-8], cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    frame.set_title(f"One of {len(frames)} frames, as the camera sees it", fontsize=10, loc="left")
    frame.set_xlabel("camera column [px]")
    frame.set_ylabel("camera row [px]")
    mirror_map(map_z, grid, grid.z, "Height", "z [mm]")
    style = {"cmap": "cividis", "norm": LogNorm()}
    mirror_map(map_sigma, grid, 1e6 * grid.sigma, "Its standard deviation", "sigma [nm]", **style)
    figure.savefig(path)


if __name__ == "__main__":
    readme(Path(sys.argv[1]))
