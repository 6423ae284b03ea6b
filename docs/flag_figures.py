"""A gallery of flags: for each a simulated capture that makes it, one frame and the pixels that carry it.

A case that no longer makes its flag ends the build: the page would show something else than it says.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray
from sheet import new_figure

from optolever.decode import Correspondence, Flag, decode
from optolever.patterns import Sequence, sequence
from optolever.projector import capture
from optolever.reconstruct import HeightFlag, exact_correspondence, reconstruct
from optolever.scene import Scene, dent_from_text, load, resize, trace

Frames = NDArray[np.uint8]
Change = Callable[[NDArray[np.float64]], NDArray[np.float64]]
ROWS, COLS = 120, 160


@dataclass(frozen=True)
class Case:
    """What is captured, and what happens to its frames (levels as floats) before they are decoded."""

    flag: Flag | HeightFlag
    dent: str = "gaussian:peak=0.2,sigma=6"
    noise: float = 1.0
    change: Change = lambda frames: frames
    show: int = -6  # frame of the picture


#: Frame that `dimmed` darkens.
DIMMED = -2


def spot(row: float, col: float, radius: float) -> NDArray[np.bool_]:
    """A disk of camera pixels."""
    rows, cols = np.mgrid[:ROWS, :COLS]
    return np.asarray(np.hypot(rows - row, cols - col) < radius)


def in_spot(value: Change) -> Change:
    """A change of the frames (N, H, W) in a disk alone."""

    def change(frames: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(spot(60, 60, 28), value(frames), frames)

    return change


def hazy(frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """A twentieth of the contrast, and the camera's noise of one level."""
    noise = np.random.default_rng(2).normal(size=frames.shape)
    return np.asarray(110 + 0.05 * frames + noise)


def dimmed(frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """One step of a fringe has half of its light."""
    changed = frames.copy()
    changed[DIMMED] *= 0.5
    return changed


def dust(frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """Single pixels that see another place."""
    rng = np.random.default_rng(1)
    rows, cols = rng.integers(5, ROWS - 5, 60), rng.integers(5, COLS - 5, 60)
    changed = frames.copy()
    changed[:, rows, cols] = frames[:, (rows + 3) % ROWS, (cols + 11) % COLS]
    return changed


CASES = (
    Case(Flag.DARK, change=in_spot(lambda frames: 0.01 * frames)),
    Case(Flag.SATURATED, change=in_spot(lambda frames: frames + 200)),
    Case(Flag.LOW_CONTRAST, change=in_spot(lambda frames: 110 + 0.01 * frames)),
    Case(Flag.ORDER_DOUBTFUL, change=in_spot(hazy)),
    Case(Flag.OFF_PATTERN, dent="tilt:slope=0.1"),
    Case(Flag.OUTLIER, change=dust),
    Case(Flag.WRONG_FRAME, change=in_spot(dimmed), show=DIMMED),
    Case(HeightFlag.CURL, dent="flat"),
    Case(HeightFlag.STEEP, dent="gaussian:peak=2,sigma=1"),
    Case(HeightFlag.NO_ANCHOR),
)


def prism() -> Scene:
    """The rig of all cases."""
    return resize(load("prism48", exact=True), ROWS, COLS)


def frames_of(case: Case, rig: Scene) -> tuple[Frames, Sequence]:
    """Frames of a case as its decoder gets them."""
    shown = sequence("gray+phase", rig.pattern.rows, rig.pattern.cols)
    seen = capture(rig, dent_from_text(case.dent, rig), shown, noise=case.noise, seed=1)
    return np.clip(np.rint(case.change(seen.frames.astype(np.float64))), 0, 255).astype(np.uint8), shown


def flags_of(case: Case, rig: Scene, where: Correspondence) -> NDArray[np.integer[Any]]:
    """Flags (H, W) of the decoder, or of the solver where the case is its own.

    CURL: single coordinates that are off, unflagged. STEEP: exact places of a dent of few pixels.
    NO_ANCHOR: a ring without a measurement.
    """
    if isinstance(case.flag, Flag):
        return where.flags
    mask = None
    if case.flag is HeightFlag.CURL:
        wrong = spot(60, 60, 6) & (np.indices((ROWS, COLS)) % 4 == 0).all(axis=0)
        where = replace(where, u=np.where(wrong, where.u + 1.5, where.u))
    if case.flag is HeightFlag.STEEP:
        where = exact_correspondence(trace(rig, dent_from_text(case.dent, rig)), 0.02)
    if case.flag is HeightFlag.NO_ANCHOR:
        mask = ~(spot(60, 80, 34) & ~spot(60, 80, 26))
    return reconstruct(where, rig, mask=mask).flags


def draw(case: Case, rig: Scene, path: Path) -> None:
    """One frame, and the pixels that carry the flag in red, others with a flag in grey."""
    frames, shown = frames_of(case, rig)
    flags = flags_of(case, rig, decode(frames, shown))
    carry = (flags & int(case.flag)) != 0
    if not carry.any():
        raise SystemExit(f"flags: no pixel carries {case.flag.name}, its case must be drawn anew")
    figure = new_figure(6.4, 2.7)
    left, right = figure.subplots(1, 2)
    left.imshow(frames[case.show], cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    left.set_title("one frame", fontsize=9, loc="left")
    index = np.where(carry, 2, np.where(flags != 0, 1, 0))
    right.imshow(index, cmap=ListedColormap(["#dfe5ea", "#8a8f98", "#c8553d"]), vmin=0, vmax=2)
    right.set_title(f"{case.flag.name}: {carry.mean():.1%} (red)", fontsize=9, loc="left")
    for axes in (left, right):
        axes.set_xticks([])
        axes.set_yticks([])
    figure.savefig(path)


def gallery(folder: Path) -> None:
    """One picture per case, named by its flag."""
    rig = prism()
    for case in CASES:
        draw(case, rig, folder / f"flag_{case.flag.name}.png")
