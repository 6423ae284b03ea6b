"""sofast_facet: a heliostat facet measured by OpenCSP's SOFAST; its own result is the answer to compare with.

Its slopes rest on a fitted paraboloid; the free-form solve here finds height from the screen points alone.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from optolever.cli import run
from optolever.decode import Correspondence
from optolever.formats import SofastRig, load_sofast_rig, on_rig
from optolever.metrology import fit_form
from optolever.reconstruct import HeightMap, SlopeMap, reconstruct

h5py = pytest.importorskip("h5py", reason="h5py is absent: pip install 'optolever[sofast]'")
pytestmark = pytest.mark.slow  # decoded by a response that its frames contradict: twice

Floats = NDArray[np.float64]

FACET = "DataSofastCalculation/facet/facet_000/"
COLS, ROWS = 2000, 1000  # nominal pixels of formats.load_sofast


def expected(real: Path, name: str) -> Floats:
    """A dataset of OpenCSP's result."""
    with h5py.File(real / "sofast_facet/data_expected_facet.h5") as file:
        return np.asarray(file[FACET + name], dtype=np.float64)


@pytest.fixture(scope="module")
def rig(real: Path) -> SofastRig:
    return load_sofast_rig(real / "sofast_facet/data_expected_facet.h5")


@pytest.fixture(scope="module")
def screen_file(real: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Decoded with the response table, through the command line."""
    out = tmp_path_factory.mktemp("sofast") / "c.npz"
    folder = real / "sofast_facet"
    response = ["--response", str(folder / "image_calibration.h5")]
    assert run(["decode", str(folder / "measurement_facet.h5"), *response, "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def screen(screen_file: Path) -> Correspondence:
    return Correspondence.load(screen_file)


def off_the_rim(good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (H, W) more than four from one that is not good."""
    return np.asarray(scipy.ndimage.binary_erosion(good, np.ones((9, 9))))


def test_screen_fractions(real: Path, rig: SofastRig, screen: Correspondence) -> None:
    """SOFAST states the mean over a pixel; the centre differs by a share of the curvature, and along the rim,
    where half a pixel is dark, by up to a part of a pixel, within five sigma."""
    x, y = expected(real, "CalculationDataGeometryFacet/v_screen_points_fractional_screens")
    use = screen.good[rig.mask]
    assert use.mean() > 0.97
    inner = use & off_the_rim(screen.good)[rig.mask]
    error = np.stack([screen.u[rig.mask] / COLS - x, 1 - screen.v[rig.mask] / ROWS - y])
    sigma = np.stack([screen.sigma_u[rig.mask] / COLS, screen.sigma_v[rig.mask] / ROWS])
    assert np.sqrt(np.mean(error[:, inner] ** 2)) < 5e-5
    assert (np.abs(error) > 5 * sigma)[:, use].mean() < 1e-2


def test_heights_by_the_command_line(real: Path, rig: SofastRig, screen_file: Path, tmp_path: Path) -> None:
    """decode and reconstruct, no Python between: slopes within 5 microradian rms of SOFAST's, and at most 30
    (asked for), on a facet 1.9 mm deep; their sigma is 14 and 20 times as wide (docs/limits.md).
    """
    result, out = real / "sofast_facet/data_expected_facet.h5", tmp_path / "h.npz"
    slopes_file = tmp_path / "s.npz"
    args = ["reconstruct", str(screen_file), "--scene", str(result), "--out", str(out)]
    assert run([*args, "--slopes", str(slopes_file)]) == 0
    height, found = HeightMap.load(out), SlopeMap.load(slopes_file)
    use = rig.mask & height.good
    assert use.sum() > 0.97 * rig.mask.sum()
    use &= off_the_rim(height.good)
    error = np.stack([found.slope_x, found.slope_y])[:, use]
    error -= expected(real, "SlopeSolverData/slopes_facet_xy")[:, use[rig.mask]]
    assert np.sqrt(np.mean(error**2)) < 5e-6
    assert np.quantile(np.abs(error), 0.999) < 30e-6
    sigma = np.median(np.stack([found.sigma_x, found.sigma_y])[:, use], axis=1)
    assert 1 < np.max(sigma / np.sqrt(np.mean(error**2, axis=1))) < 25
    assert run([*args, "--pixels", "64x64"]) == 2


def test_every_facet_of_an_ensemble(real: Path, screen_file: Path, tmp_path: Path) -> None:
    """The facet twice: a table, slopes and a picture of each."""
    result = tmp_path / "ensemble.h5"
    with h5py.File(real / "sofast_facet/data_expected_facet.h5") as file, h5py.File(result, "w") as both:
        for group in file:
            file.copy(group, both)
        for group in ("DataSofastCalculation/facet", "DataSofastInput/optic_definition"):
            file.copy(f"{group}/facet_000", both[group], "facet_001")
    args = ["reconstruct", str(screen_file), "--out", str(tmp_path / "h.npz")]
    numbers = tmp_path / "n.json"
    assert run([*args, "--scene", f"{result},all", "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert list(found) == ["facet_000", "facet_001"]
    fit = fit_form(HeightMap.load(tmp_path / "h_facet_001.npz"), "paraboloid")
    assert found["facet_001"]["focal_mm"][0] == pytest.approx(fit.numbers.to_dict()["focal"]["value"])
    assert found["facet_001"]["slope_y"][0] == pytest.approx(fit.slope_rms[1], rel=0.01)
    assert (tmp_path / "h_facet_001_slopes.png").stat().st_size > 10_000


def test_the_facet_from_inputs_alone(
    real: Path, rig: SofastRig, screen: Correspondence, screen_file: Path, tmp_path: Path
) -> None:
    """The same surface in another frame (SOFAST refines its pose by the facet's corners, the inputs' one is
    0.8 degrees from it): to 0.5 % of its curvature, which the two frames' distances, 12 mm apart, leave."""
    folder, groups = real / "sofast_facet", ("Camera", "DisplayShape", "SpatialOrientation")
    for group in groups:
        made = tmp_path / f"{group}.h5"
        with h5py.File(folder / "data_expected_facet.h5") as file, h5py.File(made, "w") as part:
            file.copy(group, part)
    files = [*(tmp_path / f"{group}.h5" for group in groups), folder / "measurement_facet.h5"]
    out = tmp_path / "h.npz"
    words = ["reconstruct", str(screen_file), "--scene", ",".join(map(str, files)), "--out", str(out)]
    assert run(words) == 0
    found, given = HeightMap.load(out), reconstruct(on_rig(screen, rig), rig.scene, anchor=rig.datum)
    use = rig.mask & found.good & given.good
    assert use.sum() > 0.97 * rig.mask.sum()
    one, other = (np.stack([each.x, each.y, each.z], axis=-1)[use] for each in (found, given))
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    left, _, right = np.linalg.svd(one.T @ other)
    error = (one @ left @ right - other)[:, 2]
    assert np.sqrt(np.mean(error**2)) < 2e-3
    x, y = other[:, :2].T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    both = np.linalg.lstsq(terms, np.stack([error, other[:, 2]], axis=-1))[0]
    assert np.abs(both[3:, 0]).max() < 0.005 * np.abs(both[3:, 1]).max()
    assert np.std(error - terms @ both[:, 0]) < 3e-4
