"""Every scene has a covariance: modes against rigs that are off, impossible scenes, the press as its own
rest.

Truth is traced by `scene.trace` through the rig as it is; modes are compared with whole solves by other
scenes.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lab.calibration.rigs import behind_face
from lab.calibration.typed import typed_runs
from optolever import InputError
from optolever.decode import Correspondence
from optolever.reconstruct import HeightFlag, HeightMap, PixelAnchor, explain, reconstruct
from optolever.scene import (
    TYPED,
    Scene,
    Trace,
    adjusted,
    dent,
    load,
    parameter_values,
    resize,
    rig_covariance,
    trace,
    typed_sigmas,
)

from .conftest import correspondence_of

NOISE = 0.01  # px
SIZE = 90, 120
PRISM = resize(load("prism48"), *SIZE)
FACE = replace(behind_face(SIZE[1]), accuracy=TYPED)
AIR = resize(load("monitor-mirror"), *SIZE)
SCENES = {"prism": PRISM, "face": FACE, "air": AIR}
ANCHOR = PixelAnchor(45, 24, 0.0)


def captured(
    scene: Scene, name: str = "gaussian", noise: float = NOISE, seed: int = 0
) -> tuple[Trace, Correspondence]:
    """A capture of a dent in the middle of the mirror, or of the mirror at rest ('flat')."""
    length = scene.mirror.length
    depth = {"peak": length / 300, "sigma": length / 12} if name == "gaussian" else {}
    truth = trace(scene, dent(name, scene, **depth))
    return truth, correspondence_of(truth, NOISE, noise, seed)


def off(scene: Scene, name: str, times: float) -> Scene:
    """The scene with one of its numbers off by `times` standard deviations of a typed one."""
    return adjusted(scene, {name: parameter_values(scene)[name] + times * typed_sigmas(scene)[name]})


def interior(height: HeightMap) -> NDArray[np.bool_]:
    """Good pixels a tenth of the mirror away from the pattern's edge, where modes of single pixels are
    large."""
    with np.errstate(invalid="ignore"):
        return np.asarray(height.good & (height.x > 0.1 * np.nanmax(height.x)))


@pytest.mark.daily(2)
@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("against_rest", [False, True], ids=["alone", "rest"])
def test_modes_are_what_whole_solves_by_other_scenes_change(kind: str, against_rest: bool) -> None:
    """Against rest but for sag and motion, which are taken off where they stand out from noise."""
    scene = SCENES[kind]
    base = scene if against_rest else replace(scene, accuracy=None)
    _, press = captured(scene, noise=0.0)
    rest = captured(scene, "flat", 0.0)[1] if against_rest else None
    known = rig_covariance(scene)
    assert known is not None
    height = reconstruct(press, scene, anchor=ANCHOR, rest=rest)
    assert height.calibration is not None
    assert height.displacement is not None
    own = reconstruct(press, base, anchor=ANCHOR, rest=rest)
    inside, share = interior(own), 0.1
    modes = {}
    # rows of a root are single numbers here: the typed ones are independent
    for row, mode, moved in zip(known.root, height.calibration, height.displacement, strict=False):
        modes[known.names[int(np.argmax(np.abs(row)))]] = np.sign(row[np.argmax(np.abs(row))]) * mode, moved
    assert set(modes) == set(typed_sigmas(scene))
    largest = max(float(np.sqrt(np.mean(mode[inside] ** 2))) for mode, _ in modes.values())
    told = "camera.rx camera.pitch_u camera.f pattern.x pattern.rz face.index pattern.pitch"
    for name in (name for name in told.split() if name in modes):
        other = reconstruct(press, off(base, name, share), anchor=ANCHOR, rest=rest)
        both = inside & other.good
        change = (other.z - own.z)[both] / share
        left = change - modes[name][0][both]
        if against_rest:
            fitted = height.calibration[-height.own :][:, both].T
            left = left - fitted @ np.linalg.lstsq(fitted, left, rcond=1e-6)[0]
            change = change - fitted @ np.linalg.lstsq(fitted, change, rcond=1e-6)[0]
        assert np.sqrt(np.mean(left**2)) < 0.05 * np.sqrt(np.mean(change**2)) + 1e-3 * largest, name


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["both poses", "glass", "motion, sag", "all"])
def test_no_height_of_a_rig_that_is_not_as_typed_is_silent(kind: str) -> None:
    runs = list(typed_runs((kind,), range(2)))
    assert not [run for run in runs if run.named or run.refused]
    assert all(run.beyond < 0.01 for run in runs)
    assert all(run.sigma < 0.012 for run in runs if run.rest)  # and total sigma is no excuse


def test_the_rig_explains_slopes_that_contradict_each_other() -> None:
    true = adjusted(
        PRISM, {name: parameter_values(PRISM)[name] + sigma for name, sigma in typed_sigmas(PRISM).items()}
    )
    (_, press), (_, rest) = captured(true), captured(true, "flat", seed=1)
    believed = reconstruct(press, replace(PRISM, accuracy=None), rest=rest)
    doubted = reconstruct(press, PRISM, rest=rest)
    assert believed.diagnostics.chi2 is not None
    assert doubted.diagnostics.chi2 is not None
    assert believed.diagnostics.chi2 > 20
    assert doubted.diagnostics.chi2 < 1.5
    assert not doubted.notices


def test_exact_scenes_have_neither_modes_nor_displacement() -> None:
    _, press = captured(PRISM)
    exact, typed = (reconstruct(press, scene) for scene in (replace(PRISM, accuracy=None), PRISM))
    assert exact.calibration is None
    assert exact.displacement is None
    assert np.array_equal(exact.z, typed.z, equal_nan=True)
    assert np.array_equal(exact.sigma, typed.sigma, equal_nan=True)
    assert (typed.total_sigma[typed.good] > 1e3 * exact.sigma[exact.good]).any()


def pitched(scene: Scene, ratio: float) -> Scene:
    return replace(scene, pattern=replace(scene.pattern, pitch=ratio * scene.pattern.pitch))


COLS, ROWS = PRISM.pattern.cols, PRISM.pattern.rows
#: In words, what a capture is with the mistake, the scene with it; a pitch may as well be the cells' size.
MISTAKES = {
    "u runs the other way along the display": (lambda c: replace(c, u=COLS - 1 - c.u), PRISM),
    "v runs the other way along the display": (lambda c: replace(c, v=ROWS - 1 - c.v), PRISM),
    "the display is turned by 180 degrees": (lambda c: replace(c, u=COLS - 1 - c.u, v=ROWS - 1 - c.v), PRISM),
    "u and v are exchanged": (lambda c: replace(c, u=c.v, v=c.u), PRISM),
    "ten times smaller": (lambda c: c, pitched(PRISM, 10.0)),
    "ten times larger": (lambda c: c, pitched(PRISM, 0.1)),
}


@pytest.mark.daily(2)
@pytest.mark.parametrize("words", MISTAKES)
@pytest.mark.parametrize("against_rest", [True, False], ids=["rest", "alone"])
def test_a_mistake_in_the_scene_is_named(words: str, against_rest: bool) -> None:
    """All pixels are flagged; or nothing can be solved."""
    change, scene = MISTAKES[words]
    press, at_rest = (change(captured(PRISM, name, seed=k)[1]) for k, name in enumerate(("gaussian", "flat")))
    rest = at_rest if against_rest else None
    found = explain(press, scene, rest)
    assert any(words in one for one in found)
    assert len(found) <= 3
    said = ""
    try:
        height = reconstruct(press, scene, anchor=ANCHOR, rest=rest)
    except InputError as error:
        said = str(error)
    if said:
        assert words in said
        return
    assert height.implausible
    assert any(words in notice.cure for notice in height.notices)
    assert reconstruct(press, scene, anchor=ANCHOR, rest=rest, accept=True).good.any()


@pytest.mark.parametrize(
    ("words", "turn"),
    [
        ("left to right", lambda m: m[:, ::-1]),
        ("top to bottom", lambda m: m[::-1]),
        ("180 degrees", lambda m: m[::-1, ::-1]),
    ],
)
def test_a_press_whose_pictures_are_turned_against_rest_is_refused(
    words: str, turn: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> None:
    press, rest = (captured(PRISM, name, seed=k)[1] for k, name in enumerate(("gaussian", "flat")))
    arrays = {name: turn(getattr(press, name)) for name in ("u", "v", "sigma_u", "sigma_v", "flags")}
    height = reconstruct(replace(press, **arrays), PRISM, rest=rest)
    assert height.implausible
    assert any(words in notice.cure for notice in height.notices)


@pytest.mark.parametrize("against_rest", [True, False], ids=["rest", "alone"])
def test_a_scene_without_a_mistake_is_not_explained(against_rest: bool) -> None:
    press, rest = (captured(PRISM, name, seed=k)[1] for k, name in enumerate(("gaussian", "flat")))
    assert explain(press, PRISM, rest if against_rest else None) == ()


def test_an_exact_scene_that_is_impossible_is_refused() -> None:
    _, press = captured(PRISM)
    turned = replace(press, u=PRISM.pattern.cols - 1 - press.u)
    height = reconstruct(turned, replace(PRISM, accuracy=None))
    assert bool((height.flags & HeightFlag.IMPLAUSIBLE).all())


@pytest.mark.slow
def test_presses_against_one_rest_subtract() -> None:
    """Errors of the rig cancel in a difference, motions of the rig since the rest capture do not."""
    _, rest = captured(PRISM, "flat", seed=1)
    one, two = (reconstruct(captured(PRISM, seed=seed)[1], PRISM, rest=rest) for seed in (2, 3))
    assert one.calibration is not None
    less = one - two
    assert less.calibration is not None
    common = less.calibration[: -less.own]
    both = less.good
    left = np.median(np.sqrt((common[:, both] ** 2).sum(axis=0)))
    assert left < 0.05 * np.median(one.calibration_sigma[both])
    motion = np.sqrt((one.calibration[-one.own :, both] ** 2).sum(axis=0))
    assert (one.difference(two)[1][both] > motion).all()


def test_the_place_of_a_mirror_is_as_sure_as_the_aim() -> None:
    """Flats leave free where the camera looks on the mirror: the foot of its middle ray, traced with
    300 drawn aims of the typed accuracy, and the typed position."""
    calibrated = replace(AIR, covariance=rig_covariance(AIR))
    height = reconstruct(captured(AIR)[1], calibrated)
    assert height.displacement is not None
    sigma = np.sqrt(np.sum((height.displacement[-3:-1] @ np.array([1.0, 75.0, 55.0])) ** 2))
    rng, feet = np.random.default_rng(1), []
    for _ in range(300):
        turns = {f"camera.{name}": TYPED.angle * rng.standard_normal() for name in ("rx", "ry")}
        own = parameter_values(AIR)
        camera = adjusted(AIR, {name: own[name] + by for name, by in turns.items()}).camera
        start, way = camera.rays_at(np.array([SIZE[0] / 2]), np.array([SIZE[1] / 2]))
        feet.append((start - start[:, 2:] / way[:, 2:] * way)[0, :2])
    assert sigma == pytest.approx(np.sqrt(np.var(feet, axis=0).sum() + 2 * TYPED.distance**2), rel=0.25)
