"""All figures of the pages, from the program's own output: `python docs/figures.py FOLDER`.

`python docs/figures.py docs/readme.png` draws the README's picture, which is committed.
"""

import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import rig_figures
from flag_figures import gallery
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rig_figures import CAMERA, MIRROR, PATTERN
from sheet import new_figure

from optolever.arrays import Floats
from optolever.decode import Correspondence, decode
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.reconstruct import Grid, PointAnchor, null_space, reconstruct
from optolever.scene import Scene, Trace, dent_from_text, load, resize, trace

PRESS = "gaussian:peak=0.2,sigma=6"


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
    rig = resize(load("prism48", exact=True), 300, 400)
    frames, seen, _ = measured(rig, "gaussian:peak=0.3,sigma=6,x=24,y=20")
    grid = reconstruct(seen, rig).resample()
    figure = new_figure(9.6, 5.8)
    side, frame, map_z, map_sigma = figure.subplots(2, 2).flat
    rig_figures.rig(side, load("prism48", exact=True), dent="gaussian:peak=0.3,sigma=6,x=24,y=22")
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


def side_view(name: str, path: Path) -> None:
    """The cut of a preset's rig with its axes."""
    scene = load(name, exact=True)
    figure = new_figure(7.2, 5.0)
    axes = figure.subplots()
    rig_figures.rig(axes, scene)
    rig_figures.names(axes, scene)
    rig_figures.frame_of_reference(axes, scene)
    axes.margins(0.08)
    figure.savefig(path)


def theta(path: Path) -> None:
    """A mirror at rest and one tilted by theta: the camera's ray, and both reflected ones."""
    figure = new_figure(6.4, 3.8)
    axes = figure.subplots()
    tilt, beta = np.radians(12.0), np.radians(45.0)
    for angle, style in ((0.0, "--"), (tilt, "-")):
        along = np.array([np.cos(angle), np.sin(angle)])
        normal = np.array([-np.sin(angle), np.cos(angle)])
        axes.plot(*np.stack([-along, along], axis=1), style, color=MIRROR, lw=2)
        axes.annotate("", 0.9 * normal, (0, 0), arrowprops={"arrowstyle": "->", "color": MIRROR, "ls": style})
        incoming = np.array([-np.sin(beta), -np.cos(beta)])  # as the camera looks
        out = incoming - 2 * (incoming @ normal) * normal
        axes.annotate("", 1.3 * out, (0, 0), arrowprops={"arrowstyle": "->", "color": PATTERN, "ls": style})
    axes.annotate("", (0, 0), (-1.3 * incoming), arrowprops={"arrowstyle": "->", "color": CAMERA})
    for place, text, colour in (
        ((0.95, 0.72), "camera's ray, beta from the normal at rest", CAMERA),
        ((-1.3, 1.0), "at rest: alpha = beta", PATTERN),
        ((-1.9, 0.52), "alpha = beta + 2 theta", PATTERN),
        ((1.03, 0.2), "theta > 0: z rises with x", MIRROR),
        ((1.03, -0.06), "mirror at rest, x", MIRROR),
    ):
        axes.text(*place, text, color=colour, fontsize=9)
    axes.set_xlim(-1.9, 2.4)
    axes.set_ylim(-0.4, 1.15)
    axes.set_aspect("equal")
    axes.set_axis_off()
    figure.savefig(path)


def modes(path: Path) -> None:
    """The free mode of a prism and of a monitor rig."""
    figure = new_figure(8.6, 3.2)
    for axes, name in zip(figure.subplots(1, 2), ("prism48", "monitor-mirror"), strict=True):
        rig = resize(load(name, exact=True), 60, 80)
        rest = trace(rig, dent_from_text("flat", rig))
        image = axes.scatter(rest.x, rest.y, c=null_space(rig), s=4, cmap="viridis", marker="s")
        axes.set_aspect("equal")
        axes.set_title(name, fontsize=10, loc="left")
        axes.set_xlabel("x [mm]")
        axes.set_ylabel("y [mm]")
        figure.colorbar(image, ax=axes, label="mode (largest value 1)", shrink=0.85)
    figure.savefig(path)


def anchors(where: Correspondence, rig: Scene, path: Path) -> None:
    """One capture, a point next to the camera taken for 0, 10 and -10 um: profiles in the middle row."""
    figure = new_figure(7.0, 3.2)
    axes = figure.subplots()
    for z, colour in ((-0.01, CAMERA), (0.0, MIRROR), (0.01, PATTERN)):
        height = reconstruct(where, rig, anchor=PointAnchor(57.0, 22.5, z))
        row = height.z.shape[0] // 2
        good = height.good[row]
        label = f"anchor at x = 57 mm: z = {1e3 * z:+.0f} um"
        axes.plot(height.x[row][good], height.z[row][good], color=colour, label=label)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("z [mm]")
    axes.legend(fontsize=8)
    figure.savefig(path)


def sigma(where: Correspondence, truth: Trace, path: Path) -> None:
    """Error of u over its sigma: map and histogram beside the normal distribution."""
    ratio = np.where(where.good, (where.u - truth.u) / where.sigma_u, np.nan)
    figure = new_figure(9.0, 3.2)
    left, right = figure.subplots(1, 2)
    image = left.imshow(ratio, cmap="RdBu_r", vmin=-4, vmax=4, interpolation="nearest")
    figure.colorbar(image, ax=left, label="error / sigma of u", shrink=0.85)
    left.set_xlabel("camera column [px]")
    left.set_ylabel("camera row [px]")
    edges = np.linspace(-5, 5, 81)
    right.hist(ratio[np.isfinite(ratio)], edges, density=True, color="#b9c6d2", label="measured")
    right.plot(
        edges, np.exp(-0.5 * edges**2) / np.sqrt(2 * np.pi), color=PATTERN, label="normal distribution"
    )
    right.set_xlabel("error / sigma of u")
    right.legend(fontsize=8)
    figure.savefig(path)


def pages(folder: Path) -> None:
    """Every figure of the pages into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    side_view("prism48", folder / "prism.png")
    side_view("monitor-mirror", folder / "monitor.png")
    theta(folder / "theta.png")
    modes(folder / "free_mode.png")
    rig = resize(load("prism48", exact=True), 150, 200)
    _, where, truth = measured(rig, PRESS)
    anchors(where, rig, folder / "anchors.png")
    sigma(where, truth, folder / "sigma.png")
    gallery(folder)


if __name__ == "__main__":
    target = Path(sys.argv[1])
    if target.suffix == ".png":
        readme(target)
    else:
        pages(target)
