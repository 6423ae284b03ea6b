"""The stored mirror at rest: heights above it; absolute heights."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.calibration.rigs import Rig, correspondence_of, prism
from optolever import InputError
from optolever.calibration import calibrate, load_rest, store_rest
from optolever.decode import Correspondence
from optolever.files import together
from optolever.reconstruct import reconstruct
from optolever.scene import Covariance, load, trace


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


def test_kept_with_a_rig_that_is_written_with_it(rig: Rig, tmp_path: Path) -> None:
    """All or nothing: the second writer of rig.toml keeps what the first has written."""
    file = tmp_path / "rig.toml"
    with together():
        rig.truth.save(file)
        store_rest(file, captured(rig, False))
        rig.truth.save(file)
        assert not file.exists()
    assert load(file) == rig.truth
    assert load_rest(file) is not None


def test_kept_with_the_rig(rig: Rig, tmp_path: Path) -> None:
    """As heights against it, of a rig that sags."""
    file, seen = tmp_path / "rig.toml", captured(rig, False)
    rig.truth.save(file)
    assert load_rest(file) is None
    places = store_rest(file, seen)
    assert load(file) == rig.truth
    rig.truth.save(file)  # what a later calibration writes
    found = load_rest(file)
    assert found is not None
    assert np.array_equal(found.good, seen.good)
    height, truth = reconstruct(captured(rig, True, 1), rig.truth, rest=found), trace(rig.truth, rig.dent)
    with np.errstate(invalid="ignore"):
        true = rig.dent.height(truth.x, truth.y) - rig.rest.height(truth.x, truth.y)
    both = height.good & np.isfinite(true) & (truth.x > 10)
    error = (height.z - true)[both]
    assert both.sum() > 2000
    assert np.sqrt(np.mean(error**2)) < 0.003 * 0.3  # a dent over a fifth of the mirror
    assert np.sqrt(np.mean((error / height.total_sigma[both]) ** 2)) < 2
    places.unlink()
    with pytest.raises(InputError, match=r"rig\.rest_places\.npz"):
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


def test_presets_have_none() -> None:
    assert load_rest("prism48") is None
