"""The paper's method on a scene: the prism's numbers, and every camera row as one line of the recursion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from optolever import InputError
from optolever.decode import Correspondence
from optolever.reconstruct import HeightFlag, HeightMap, rest_corrected
from optolever.scene import Scene, TelecentricCamera

from .recursion import PaperGeometry, PaperResult, SeriesName, recursion

__all__ = [
    "PAPER_METHODS",
    "capture_positions",
    "pattern_positions",
    "prism_geometry",
    "reconstruct_paper",
    "row_recursion",
]

Array = NDArray[np.float64]
#: Names of `optolever reconstruct --method`, and the series that each stands for.
PAPER_METHODS: dict[str, SeriesName] = {"paper": "mean", "paper-rises": "rises", "paper-drops": "drops"}
_EXACT = 1e-6  # of the mirror's length, and rad: how exactly the scene has to be a prism


def prism_geometry(scene: Scene) -> PaperGeometry:
    """The angles and the length of a telecentric prism: both faces stand on the mirror's edges, along y.

    InputError if the scene is anything else, since the paper's equations are about nothing else.
    """
    camera, pattern = scene.camera, scene.pattern
    if not isinstance(camera, TelecentricCamera) or camera.face is not None:
        raise InputError(
            f"scene {scene.name}: camera is {_kind(scene)}, the paper's method needs a telecentric one "
            "inside the prism"
        )
    for name, axis in (("pattern.v_axis", pattern.v_axis), ("camera.v_axis", camera.v_axis)):
        if abs(axis[1] - 1) > _EXACT:
            raise InputError(f"scene {scene.name}: {name} is {axis}, the paper's method needs (0, 1, 0)")
    gap = float(pattern.origin @ pattern.normal)
    if abs(gap) > _EXACT * scene.mirror.length:
        raise InputError(
            f"scene {scene.name}: pattern.origin is {gap:.3g} mm off the mirror's edge x = 0, the paper's "
            f"method allows {_EXACT * scene.mirror.length:.1g} mm"
        )
    alpha0 = float(np.arctan2(pattern.u_axis[2], pattern.u_axis[0]))
    beta0 = float(np.arctan2(camera.u_axis[2], -camera.u_axis[0]))
    return PaperGeometry(alpha0, beta0, scene.mirror.length)


def pattern_positions(scene: Scene, u: Array) -> Array:
    """m in mm of pattern columns u (cells): the distance from P0 along the pattern face."""
    return np.asarray(scene.pattern.origin @ scene.pattern.u_axis + u * scene.pattern.pitch)


def capture_positions(scene: Scene, row: Array | float, col: Array | float) -> Array:
    """w in mm of camera pixels: the distance from R0 along the capture face."""
    origins = scene.camera.rays_at(row, col)[0]
    geometry = prism_geometry(scene)
    along = np.array([-np.cos(geometry.beta0), 0.0, np.sin(geometry.beta0)])
    # the rays are perpendicular to the face: where along them they start does not matter
    return np.asarray((origins - np.array([geometry.length, 0.0, 0.0])) @ along)


def row_recursion(
    correspondence: Correspondence, scene: Scene, *, sign: int = 1, gamma: bool = True
) -> PaperResult:
    """The recursion along every camera row; fields are (H, W), NaN where the correspondence carries a
    flag.
    """
    geometry = prism_geometry(scene)
    rows, cols = scene.camera.rows, scene.camera.cols
    if correspondence.u.shape != (rows, cols):
        raise InputError(
            f"correspondence: shape is {correspondence.u.shape}, the camera of scene {scene.name} has "
            f"{(rows, cols)}"
        )
    u = np.asarray(correspondence.u, dtype=np.float64)
    m = np.where(correspondence.good, pattern_positions(scene, u), np.nan)
    w = np.broadcast_to(capture_positions(scene, 0.0, np.arange(cols, dtype=np.float64)), m.shape)
    # column 0 is next to x = L0, the recursion's points run from l = 0 on
    backward = recursion(m[:, ::-1], w[:, ::-1], geometry, sign=sign, gamma=gamma)
    return backward.reversed()


def reconstruct_paper(
    correspondence: Correspondence,
    scene: Scene,
    *,
    sign: int = 1,
    gamma: bool = True,
    series: SeriesName = "mean",
    rest: Correspondence | None = None,
) -> HeightMap:
    """Height by the paper's recursion on every pixel of every camera row. InputError unless the scene is a
    prism.

    sign: +1 the reflection law, -1 the paper's print; gamma: kept, or 0 as the paper has it; series: rises,
    drops or their mean; rest: as in `reconstruct`. Flags and notices are those of the correspondence. The
    method knows no uncertainty: sigma is inf.
    """
    if rest is not None:
        correspondence = rest_corrected(correspondence, rest, scene)
    profile = row_recursion(correspondence, scene, sign=sign, gamma=gamma).series(series)
    rows = np.arange(scene.camera.rows, dtype=np.float64)
    y = scene.camera.rays_at(rows, np.zeros_like(rows))[0][:, 1]
    lost = np.where(np.isnan(profile.d) & correspondence.good, int(HeightFlag.NOT_CONVERGED), 0)
    return HeightMap(
        x=profile.l,
        y=np.where(np.isnan(profile.d), np.nan, y[:, None]),
        z=profile.d,
        sigma=np.full(profile.d.shape, np.inf),
        flags=(correspondence.flags | lost).astype(np.uint16),
        notices=correspondence.notices,
    )


def _kind(scene: Scene) -> str:
    return "behind a face" if getattr(scene.camera, "face", None) is not None else type(scene.camera).__name__
