"""The stored mirror at rest: dents as differences, drift by the part that is untouched, bad files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.calibration.rigs import Rig, correspondence_of, prism
from optolever import InputError
from optolever.calibration import RestMap, calibrate, load_rest, store_rest
from optolever.decode import Correspondence
from optolever.reconstruct import reconstruct
from optolever.scene import Covariance, Scene, adjusted, load, trace


@pytest.fixture(scope="module")
def rig() -> Rig:
    """A rig that sags, its scene with a covariance of 0.05 mm of the pattern's place."""
    rng = np.random.default_rng(3)
    made = prism(rng, 0, correspondence_of(0.005, rng), size=100)
    known = Covariance(("pattern.x", "pattern.z"), np.diag([0.05**2, 0.05**2]))
    return replace(made, truth=replace(made.truth, covariance=known))


def captured(rig: Rig, dented: bool, seed: int = 0) -> Correspondence:
    take = correspondence_of(0.005, np.random.default_rng(seed))
    return take(rig.truth, rig.dent if dented else rig.rest, 0)


@pytest.fixture(scope="module")
def rest(rig: Rig) -> RestMap:
    seen = captured(rig, False)
    return RestMap(reconstruct(seen, rig.truth), seen)


def test_a_dent_is_the_height_less_the_rest(rig: Rig, rest: RestMap) -> None:
    height = reconstruct(captured(rig, True, 1), rig.truth)
    change, sigma = rest.dent(height)
    seen = trace(rig.truth, rig.dent)
    with np.errstate(invalid="ignore"):
        true = rig.dent.height(seen.x, seen.y) - rig.rest.height(seen.x, seen.y)
    both = np.isfinite(change) & np.isfinite(true) & (seen.x > 10)
    error = (change - true)[both]
    assert both.sum() > 2000
    assert np.sqrt(np.mean(error**2)) < 0.003 * 0.3
    assert np.sqrt(np.mean((error / sigma[both]) ** 2)) < 2
    assert np.median(sigma[both]) < 0.5 * np.median(height.total_sigma[both])


def test_a_rig_that_stands_still_has_no_notice(rig: Rig, rest: RestMap) -> None:
    for seed in range(2, 12):
        assert not rest.notices(captured(rig, False, seed))
    assert not rest.notices(_small_dent(rig, rig.truth))


def _small_dent(rig: Rig, scene: Scene) -> Correspondence:
    """Pressed over a quarter of the image."""
    take = correspondence_of(0.005, np.random.default_rng(5))
    now, touched = take(scene, rig.rest, 0), take(scene, rig.dent, 0)
    inside = np.zeros(now.u.shape, bool)
    inside[: inside.shape[0] // 2, : inside.shape[1] // 2] = True
    return replace(now, u=np.where(inside, touched.u, now.u), v=np.where(inside, touched.v, now.v))


@pytest.mark.daily(1)
@pytest.mark.parametrize("number", ["pattern.x", "camera.ry"])
def test_a_rig_that_has_moved_has_a_notice(rig: Rig, rest: RestMap, number: str) -> None:
    moved = adjusted(replace(rig.truth, covariance=None), {number: 2e-3})  # mm: 0.004 px; rad
    now = _small_dent(rig, moved)
    (notice,) = rest.notices(now)
    assert "optolever rest" in str(notice)


@pytest.mark.slow
def test_where_nothing_rests_drift_is_unknown(rig: Rig, rest: RestMap) -> None:
    (notice,) = rest.notices(captured(rig, True, 6))
    assert "drift is unknown" in str(notice)
    turned = adjusted(replace(rig.truth, covariance=None), {"camera.ry": 0.05})
    now = correspondence_of(0.005, np.random.default_rng(5))(turned, rig.rest, 0)
    (notice,) = rest.notices(now)
    assert "drift" in str(notice)


def test_kept_with_the_rig(rig: Rig, rest: RestMap, tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    rig.truth.save(file)
    assert load_rest(file) is None
    store_rest(file, rest)
    assert load(file) == rig.truth
    found = load_rest(file)
    assert found is not None
    assert np.array_equal(found.height.z, np.float32(rest.height.z), equal_nan=True)  # as files hold it
    rig.truth.save(file)  # what a later calibration writes
    assert load_rest(file) is not None
    (tmp_path / "rig.rest.npz").unlink()
    with pytest.raises(InputError, match=r"rig\.rest\.npz"):
        load_rest(file)


@pytest.mark.parametrize("seeds", [(1,), pytest.param((2, 3, 4), marks=pytest.mark.slow)])
def test_absolute_heights_of_a_calibrated_rig(seeds: tuple[int, ...], tmp_path: Path) -> None:
    """A mirror that sags by 20 um, at rest and pressed, by the default anchor of the saved rig."""
    ratios = []
    for seed in seeds:
        rng = np.random.default_rng([seed, 3])
        made = prism(rng, 2, correspondence_of(0.005, rng), size=160)
        calibrate(made.given, made.observations).scene.save(tmp_path / "rig.toml")
        calibrated = load(tmp_path / "rig.toml")
        take = correspondence_of(0.002, rng)
        for surface in (made.rest, made.dent):
            height, seen = reconstruct(take(made.truth, surface, 0), calibrated), trace(made.truth, surface)
            good = height.good & (seen.x > 6)
            error = (height.z - seen.z)[good]
            assert np.sqrt(np.mean(error**2)) < 3e-4
            ratios.append(np.mean((error / height.total_sigma[good]) ** 2))
    assert 0.5 < np.sqrt(np.mean(ratios)) < 1.5


def test_presets_have_none_and_sizes_must_agree(rig: Rig, rest: RestMap) -> None:
    assert load_rest("prism48") is None
    small = Correspondence(*np.zeros((4, 8, 8)), flags=np.zeros((8, 8), np.uint16))
    with pytest.raises(InputError, match=r"\(8, 8\)"):
        rest.notices(small)
