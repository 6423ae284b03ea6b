"""Modes of a rig's covariance in the heights, against draws of rigs that are wrong by as much."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from lab.calibration.rigs import Rig, correspondence_of, prism
from optolever import InputError
from optolever.decode import Correspondence
from optolever.reconstruct import (
    Contact,
    HeightMap,
    PointAnchor,
    SlopeMap,
    contacts,
    exact_correspondence,
    reconstruct,
    slope_map,
)
from optolever.scene import Covariance, Scene, adjusted, dent, load, parameter_values, resize, trace


@pytest.fixture(scope="module")
def rig() -> Rig:
    rng = np.random.default_rng(11)
    return prism(rng, 0, correspondence_of(0.005, rng), size=160)


def uncalibrated(scene: Scene) -> Scene:
    """Priors that a user gives: 0.1 degree, 0.05 mm."""
    sigmas = {"camera.rx": 2e-3, "camera.ry": 2e-3, "pattern.x": 0.05, "pattern.z": 0.05, "pattern.ry": 2e-3}
    return replace(scene, covariance=Covariance(tuple(sigmas), np.diag([s**2 for s in sigmas.values()])))


def exact(scene: Scene, rig: Rig, dented: bool = True) -> tuple[Correspondence, PointAnchor]:
    surface = rig.dent if dented else rig.rest
    found = exact_correspondence(trace(scene, surface), 1e-3)
    x, y = 0.9 * scene.mirror.length, 0.5 * scene.mirror.width
    z = float(surface.height(np.array(x), np.array(y)))
    return found, PointAnchor(x, y, z)


def test_saved_and_loaded(rig: Rig, tmp_path: Path) -> None:
    scene = uncalibrated(rig.truth)
    scene.save(tmp_path / "rig.toml")
    assert load(tmp_path / "rig.toml") == scene
    text = (tmp_path / "rig.toml").read_text() + "\n[devices]\ncamera = 'x'\n"
    (tmp_path / "rig.toml").write_text(text)
    scene.save(tmp_path / "rig.toml")
    assert "[devices]" in (tmp_path / "rig.toml").read_text()
    given, anchor = exact(rig.truth, rig)
    height = reconstruct(given, load(tmp_path / "rig.toml"), anchor=anchor)
    height.save(tmp_path / "h.npz")
    again = HeightMap.load(tmp_path / "h.npz")
    assert np.array_equal(again.calibration, height.calibration, equal_nan=True)
    beside = tmp_path / "rig.calibration.npz"
    np.savez(beside, **(dict(np.load(beside)) | {"matrix": -scene.covariance.matrix}))  # type: ignore[union-attr]
    with pytest.raises(InputError, match=r"rig\.calibration\.npz: .*not positive"):
        load(tmp_path / "rig.toml")
    beside.unlink()
    with pytest.raises(InputError, match=r"rig\.calibration\.npz"):
        load(tmp_path / "rig.toml")


@pytest.mark.slow
def test_figures_and_slopes_hold_the_rig() -> None:
    """Standard deviations of a dent's figures and slopes against rigs that are wrong by each row of the
    covariance's root, measured anew."""
    truth = resize(load("paper-simulation", exact=True), 128, 128)
    surface = dent("gaussian", truth, peak=1.3, sigma=14.0)
    scene = uncalibrated(truth)
    assert scene.covariance is not None
    seen = trace(truth, surface)
    given = exact_correspondence(seen, 1e-3)

    def measured(by: Scene) -> tuple[Contact, SlopeMap]:
        height = reconstruct(given, by)
        slopes = slope_map(height, given, by)
        return contacts(height)[0], slopes

    (plain, flat), (figures, slopes) = measured(truth), measured(scene)
    own, step = parameter_values(truth), 0.2
    names = ["depth", "indenter_radius"]
    squares = dict.fromkeys(names, 0.0)
    turned = np.zeros((2, *seen.u.shape))
    for row in scene.covariance.root:
        change = zip(scene.covariance.names, row, strict=True)
        wrong = adjusted(scene, {name: own[name] + step * by for name, by in change})
        moved, other = measured(wrong)
        for name in names:
            squares[name] += ((getattr(moved, name) - getattr(figures, name)) / step) ** 2
        turned += (np.stack([other.slope_x - flat.slope_x, other.slope_y - flat.slope_y]) / step) ** 2
    stated, spread = np.sqrt(figures.depth_sigma**2 - plain.depth_sigma**2), np.sqrt(squares["depth"])
    # the rim takes part of the modes off; sigma holds what tails of the dent may hide beside
    assert spread < 1.2 * stated < 4 * spread
    assert abs(figures.depth - 1.3) < 2 * figures.depth_sigma
    assert figures.indenter_radius_sigma is not None
    assert np.sqrt(squares["indenter_radius"]) < figures.indenter_radius_sigma
    for predicted, alone, square in zip(slopes.total_sigma, flat.total_sigma, turned, strict=True):
        ratio = np.sqrt(predicted**2 - alone**2) / np.sqrt(square)
        assert np.nanmedian(ratio) == pytest.approx(1, abs=0.02)
        assert np.isfinite(predicted[slopes.good]).all()  # at the map's edge, too
        edge = slopes.good & ~binary_erosion(slopes.good)
        assert np.nanmedian(ratio[edge]) == pytest.approx(1, abs=0.1)
