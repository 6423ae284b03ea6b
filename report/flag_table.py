"""Flags of a map: each pixel is counted once, under its first reason; the shares sum to one."""

import itertools
from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.decode import Flag
from optolever.reconstruct import HeightFlag
from optolever.scene import Scene

__all__ = ["MEANING", "FlagRow", "flag_index", "flag_rows", "mirror_area"]

BLOCKS = 512  # of pixels, along either side, whose areas are computed
GOOD_COLOUR = "#dfe5ea"
MEANING = {
    "DARK": "too little light came back, for instance where total reflection is lost",
    "SATURATED": "the camera was at its upper limit",
    "LOW_CONTRAST": "the pattern is too weak in this pixel to be decoded",
    "ORDER_DOUBTFUL": "the fringe order is ambiguous",
    "OFF_PATTERN": "the pixel looks past the pattern surface",
    "OUTLIER": "the coordinate does not fit its neighbours",
    "INVALID": "no data came in for this pixel, or a mask excludes it",
    "WRONG_FRAME": "frames were lost, repeated, torn or swapped",
    "NO_ANCHOR": "an island whose absolute height nothing fixes",
    "CURL": "the slopes contradict each other around this pixel",
    "STEEP": "steeper than the optical lever can measure",
    "NOT_CONVERGED": "the solver found no answer here",
    "SINGULAR": "the pattern lies within its noise of the mirror: no slope can be computed",
    "IMPLAUSIBLE": "the capture contradicts its scene: no rig of the scene's accuracy can have taken it",
}
_TAB20 = (
    "1f77b4 aec7e8 ff7f0e ffbb78 2ca02c 98df8a d62728 ff9896 9467bd c5b0d5 8c564b c49c94 e377c2 f7b6d2 "
    "7f7f7f c7c7c7 bcbd22 dbdb8d 17becf 9edae5"
)


@dataclass(frozen=True, slots=True)
class FlagRow:
    """A reason: the pixels whose first reason it is, their area (mm^2; pixels without a scene) and its share
    of all, meaning, colour."""

    name: str
    bit: int
    count: int
    area: float
    share: float
    meaning: str
    colour: str


def flag_index(flags: NDArray[np.integer], bits: list[int]) -> NDArray[np.uint8]:
    """Index in `bits` of the first reason of each pixel, 0 for none."""
    index = np.zeros(flags.shape, dtype=np.uint8)
    for place in range(len(bits) - 1, 0, -1):
        index[(flags & bits[place]) != 0] = place
    return index


def flag_rows(flags: NDArray[np.integer], area: Floats | None = None, mirror: float = 0.0) -> list[FlagRow]:
    """The reasons that occur, after a row of the pixels without any. area (H, W): mirror area of each pixel,
    mm^2; mirror: total area; the part out of view is the last row. Without areas all pixels have equal
    weight."""
    members: list[IntFlag] = [*Flag, *HeightFlag]
    index = flag_index(flags, [0, *(int(member) for member in members)])
    count = np.bincount(index.ravel(), minlength=len(members) + 1)
    weights = None if area is None else area.ravel()
    part = np.bincount(index.ravel(), weights, len(members) + 1).astype(np.float64)
    total = max(mirror, float(part.sum())) or 1.0
    words = [("good", 0, "height and error bar stand", GOOD_COLOUR)]
    words += [
        (str(each.name).lower().replace("_", " "), int(each), MEANING[str(each.name)], f"#{colour}")
        for each, colour in zip(members, itertools.cycle(_TAB20.split()), strict=False)
    ]
    rows = [
        FlagRow(name, bit, int(n), float(size), float(size) / total, meaning, colour)
        for (name, bit, meaning, colour), n, size in zip(words, count, part, strict=True)
        if n or bit == 0
    ]
    beyond = total - float(part.sum())
    if beyond > 1e-6 * total:
        rows.append(
            FlagRow("outside the image", -1, 0, beyond, beyond / total, "no camera pixel sees it", "#fff")
        )
    return rows


def mirror_area(scene: Scene) -> Floats:
    """Area of the mirror at rest in each camera pixel (H, W), mm^2: of blocks of pixels, the quadrangle of
    their corner rays on the plane z = 0, clipped at the mirror's edges, in equal parts to their pixels."""
    camera = scene.camera
    rows, cols = (
        np.unique(np.linspace(0, n, min(n, BLOCKS) + 1).round().astype(int))
        for n in (camera.rows, camera.cols)
    )
    origins, ways = camera.rays_at(rows[:, None] - 0.5, cols - 0.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = -origins[..., 2] / ways[..., 2]
    x = np.clip(origins[..., 0] + along * ways[..., 0], 0.0, scene.mirror.length)
    y = np.clip(origins[..., 1] + along * ways[..., 1], 0.0, scene.mirror.width)
    (ax, bx), (ay, by) = ((part[1:, 1:] - part[:-1, :-1], part[1:, :-1] - part[:-1, 1:]) for part in (x, y))
    high, wide = np.diff(rows), np.diff(cols)
    share = np.nan_to_num(0.5 * np.abs(ax * by - bx * ay)) / (high[:, None] * wide)
    return np.repeat(np.repeat(share, high, axis=0), wide, axis=1)
