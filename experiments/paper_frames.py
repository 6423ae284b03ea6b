"""The seed's measurement: one column of lattice crossings, found in a frame at rest and in a dented one."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever import InputError
from optolever.decode import lattice
from optolever.patterns import Sequence, sequence
from optolever.projector import capture
from optolever.reconstruct import capture_positions, pattern_positions, prism_geometry
from optolever.scene import Scene, Surface, dent, trace

__all__ = ["lattice_frames", "lattice_positions"]

PIXELS_PER_LINE = 10  # of the camera, that a lattice line needs to be told from the next
Array = NDArray[np.float64]
Frame = NDArray[Any]


def lattice_frames(
    scene: Scene, surface: Surface, lines: int, *, noise: float, seed: int, renderer: str
) -> tuple[Sequence, Frame, Frame]:
    """What was shown, and what the camera saw of it at rest and dented, (1, H, W) each.

    The lattice has `lines` lines on the stretch of the pattern seen at rest, or as many as a smaller camera
    can tell apart.
    """
    geometry, pattern = prism_geometry(scene), scene.pattern
    seen = geometry.length * np.cos(geometry.beta0) / np.cos(geometry.beta0 - geometry.alpha0)
    lines = min(lines, scene.camera.cols // PIXELS_PER_LINE)
    shown = sequence("lattice", pattern.rows, pattern.cols, period=seen / lines / pattern.pitch)
    rest, dented = (
        capture(scene, shape, shown, renderer=renderer, noise=noise, seed=seed + step).frames
        for step, shape in enumerate((dent("flat", scene), surface))
    )
    return shown, rest, dented


def lattice_positions(
    scene: Scene, shown: Sequence, rest: Frame, dented: Frame
) -> tuple[Array, Array, Array]:
    """m, w and y (mm) of the crossings along the pattern line nearest to the mirror's middle.

    m is where the crossing is printed, w and y are where it was found in the dented frame, NaN if it was
    not. InputError if fewer than two are found.
    """
    pattern = scene.pattern
    crossings = lattice(dented, rest, shown, prior=trace(scene, dent("flat", scene)))
    middle = crossings.index[np.argmin(np.abs(crossings.pattern[:, 1] - (pattern.rows - 1) / 2)), 1]
    column = crossings.index[:, 1] == middle
    found = int((column & crossings.found).sum())
    if found < 2:
        raise InputError(
            f"scene {scene.name}: {found} lattice crossings found along the middle, needs at least 2"
        )
    row, col = crossings.now[column].T
    m = pattern_positions(scene, crossings.pattern[column, 0])
    return m, capture_positions(scene, row, col), scene.camera.rays_at(row, col)[0][:, 1]
