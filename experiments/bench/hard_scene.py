"""Scenes that are a little wrong: how many are noticed, how many right ones, what a rest capture mends.

Rigs and dents are drawn (see `rigs`), their exact correspondences get white noise, and the height is solved
by the right scene, by one whose camera is turned about any axis, and by one whose pattern has another pitch.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from optolever.reconstruct import PixelAnchor, reconstruct
from optolever.scene import Scene, dent, trace

from ..drawn import between
from ..place import exact
from .found import Found, FrameVerdict, found_height
from .hard_case import Case
from .rigs import KINDS, draw_rig

__all__ = ["SCENES", "scene_cases", "scene_found", "turned"]

SCENES = ("right scene", "camera 0.2 deg", "pitch 0.2 %")
_SIZE = 96, 112
_TURN, _PITCH = np.radians(0.2), 0.002
_REST = "a rest capture takes most of it away, and no sigma knows the rest"


def scene_cases(count: int, first: int) -> Iterator[Case]:
    """All of SCENES for so many numbers, the wrong ones with a rest capture too; kinds of rigs take turns."""
    for number in range(first, first + count):
        for which in SCENES:
            for rest in (False, True)[: 1 if which == SCENES[0] else 2]:
                name = f"{which}{', rest capture' if rest else ''}: {number}"
                make, limit = partial(scene_found, number, which, rest), _REST if rest else ""
                yield Case("scene", name, KINDS[number % len(KINDS)], _SIZE, make, limit=limit)


def scene_found(number: int, which: str, rest: bool) -> Found:
    """The height by one of SCENES, errors over the depth of the usual dent; without a rest capture, whether a
    notice tells of the wrong ones."""
    rng = np.random.default_rng([0, number, 28])
    rig = draw_rig(rng, KINDS[number % len(KINDS)], _SIZE)
    noise = between(rng, 0.002, 0.1)
    truth, flat = trace(rig.scene, rig.surface), trace(rig.scene, dent("flat", rig.scene))
    seen, at_rest = (exact(one, noise=noise, rng=rng) for one in (truth, flat))
    inner = distance_transform_edt(np.pad(truth.visible & flat.visible, 1))[1:-1, 1:-1]
    row, col = (int(at) for at in np.unravel_index(int(np.argmax(inner)), inner.shape))
    anchor = PixelAnchor(row, col, float(truth.z[row, col]))
    pitch = rig.scene.pattern.pitch * (1 + float(rng.choice([-1.0, 1.0])) * _PITCH)
    turn = turned(rig.scene, rng.standard_normal(3), _TURN)
    scenes = (rig.scene, turn, replace(rig.scene, pattern=replace(rig.scene.pattern, pitch=pitch)))
    scene = scenes[SCENES.index(which)]
    height = reconstruct(seen, scene, anchor=anchor, rest=at_rest if rest else None)
    told = tuple(str(notice) for notice in height.notices)
    wrong = "" if which == SCENES[0] else which
    said = FrameVerdict(wrong, True, False, bool(told), 0 if wrong else len(told), told)
    usual = dent("gaussian", rig.scene).formula
    assert usual is not None  # named forms have one
    found = found_height(height, truth, usual.params["peak"])
    return found if rest else replace(found, frames=said)


def turned(scene: Scene, axis: NDArray[np.float64], angle: float) -> Scene:
    """The scene with its camera turned about an axis (3,) by an angle (rad)."""
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    u_axis, v_axis = turn.apply([scene.camera.u_axis, scene.camera.v_axis])
    return replace(scene, camera=replace(scene.camera, u_axis=u_axis, v_axis=v_axis))
