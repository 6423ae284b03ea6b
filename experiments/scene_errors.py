"""Scenes that are a little wrong: how many are noticed, how many right ones, what a rest capture mends.

Rigs and dents are drawn (see `bench.rigs`), their exact correspondences get white noise, and the height is
solved by the right scene, by one whose camera is turned about any axis, and by one whose pattern has another
pitch. `python -m optolever.experiments.scene_errors CASES` prints the shares.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from optolever.errors import InputError
from optolever.reconstruct import HeightMap, PixelAnchor, reconstruct
from optolever.scene import Scene, Trace, dent, trace

from .bench.rigs import KINDS, draw_rig
from .drawn import between
from .metrics import rms
from .place import exact

__all__ = ["ERRORS", "SceneError", "scene_errors", "turned"]

Floats = NDArray[np.float64]

ERRORS = ("right", "camera 0.2 deg", "pitch 0.2 %")
_SIZE = 96, 112
_TURN, _PITCH = np.radians(0.2), 0.002


@dataclass(frozen=True, slots=True)
class SceneError:
    """One solve. error, mended: rms over the truth's range, without and with a rest capture (NaN: not
    tried); chi2: see `Diagnostics`; noticed: whether the map has a notice; silent: share of good pixels
    beyond five sigma.
    """

    case: int
    kind: str
    wrong: str
    noise: float
    chi2: float
    noticed: bool
    error: float
    silent: float
    mended: float = float("nan")


def scene_errors(cases: int, seed: int = 0) -> Iterator[SceneError]:
    """All of ERRORS for every case; the kinds of rigs take turns."""
    for case in range(cases):
        rng = np.random.default_rng([seed, case, 28])
        kind = KINDS[case % len(KINDS)]
        rig = draw_rig(rng, kind, _SIZE)
        noise = between(rng, 0.002, 0.1)
        truth, flat = trace(rig.scene, rig.surface), trace(rig.scene, dent("flat", rig.scene))
        seen, rest = (exact(one, noise=noise, rng=rng) for one in (truth, flat))
        inner = distance_transform_edt(np.pad(truth.visible & flat.visible, 1))[1:-1, 1:-1]
        row, col = (int(at) for at in np.unravel_index(int(np.argmax(inner)), inner.shape))
        anchor = PixelAnchor(row, col, float(truth.z[row, col]))
        sign = float(rng.choice([-1.0, 1.0]))
        pattern = replace(rig.scene.pattern, pitch=rig.scene.pattern.pitch * (1 + sign * _PITCH))
        scenes = (
            rig.scene,
            turned(rig.scene, rng.standard_normal(3), _TURN),
            replace(rig.scene, pattern=pattern),
        )
        for wrong, scene in zip(ERRORS, scenes, strict=True):
            height = reconstruct(seen, scene, anchor=anchor)
            good = height.good & truth.visible
            silent = np.abs(height.z - truth.z)[good] > 5 * height.sigma[good]
            found = SceneError(
                *(case, kind, wrong, noise),
                chi2=height.diagnostics.chi2 or float("nan"),
                noticed=bool(height.notices),
                error=_error(height, truth),
                silent=float(silent.mean()) if good.any() else float("nan"),
            )
            if wrong != "right":
                try:
                    mended = reconstruct(seen, scene, anchor=anchor, rest=rest)
                except InputError:
                    pass
                else:
                    found = replace(found, mended=_error(mended, truth))
            yield found


def turned(scene: Scene, axis: Floats, angle: float) -> Scene:
    """The scene with its camera turned about an axis (3,) by an angle (rad), Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    camera = scene.camera
    return replace(scene, camera=replace(camera, u_axis=turn @ camera.u_axis, v_axis=turn @ camera.v_axis))


def _error(height: HeightMap, truth: Trace) -> float:
    """Rms error over the range of the truth, wherever both have a height."""
    error = (height.z - truth.z)[truth.visible & np.isfinite(height.z)]
    deep = float(np.ptp(truth.z[truth.visible]))
    return rms(error) / deep if deep > 0 else float("nan")


def main(cases: int) -> None:
    """Print every solve, then the shares."""
    found = []
    for one in scene_errors(cases):
        found.append(one)
        print(
            f"{one.case:3d} {one.kind:20s} {one.wrong:15s} noise {one.noise:.3f} chi2 {one.chi2:9.3g} "
            f"{'noticed' if one.noticed else '-':7s} error {one.error:.2e} silent {one.silent:.3f} "
            f"with rest {one.mended:.2e}",
            flush=True,
        )
    for wrong in ERRORS:
        of = [one for one in found if one.wrong == wrong]
        chi2, error, mended = (
            np.array([getattr(one, name) for one in of if np.isfinite(getattr(one, name))] or [np.nan])
            for name in ("chi2", "error", "mended")
        )
        print(
            f"{wrong}: noticed {sum(one.noticed for one in of)} of {len(of)}; chi2 {chi2.min():.3g} to "
            f"{chi2.max():.3g}; median error {np.median(error):.2e} of the depth, with a rest capture "
            f"{np.median(mended):.2e}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]))
