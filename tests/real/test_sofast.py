"""sofast_facet: a heliostat facet measured by OpenCSP's SOFAST; its own result is the answer to compare with.

Its slopes rest on a fitted paraboloid; the free-form solve here finds height from the screen points alone.
SOFAST states the mean over a pixel, and so do the first steps of decode; decode's answer is what the pixel's
centre sees, as far as neighbours show it.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.cli import run
from optolever.decode import Correspondence, Response, decode
from optolever.decode.axis import AxisOptions, Setup, Shot, axis_decoders, estimate_axes
from optolever.decode.flags import Shared
from optolever.decode.frames import light_of
from optolever.decode.plan import plan
from optolever.decode.profile.noise import estimate_noise
from optolever.decode.spatial import Raw
from optolever.projector import load_sofast, load_sofast_response
from optolever.reconstruct import HeightMap, SlopeMap, on_rig, reconstruct
from optolever.scene import SofastRig, load_sofast_rig

h5py = pytest.importorskip("h5py", reason="h5py is absent: pip install 'optolever[sofast]'")
pytestmark = pytest.mark.slow  # decoded by a response that its frames contradict: twice

Floats = NDArray[np.float64]

FACET = "DataSofastCalculation/facet/facet_000/"
COLS, ROWS = 2000, 1000  # nominal pixels of projector.load_sofast
UNSEEN = 128  # flag of a pixel without data


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


@pytest.fixture(scope="module")
def readings(real: Path, screen: Correspondence) -> Correspondence:
    """What pixels read, the mean over each: the steps of decode without those among neighbours."""
    capture = load_sofast(real / "sofast_facet/measurement_facet.h5")
    table = load_sofast_response(real / "sofast_facet/image_calibration.h5")
    light = light_of(capture.frames, capture.sequence, response=Response.from_table(*table))
    wanted = plan(capture.sequence)
    noise, lit = estimate_noise(light, wanted)
    setup = Setup(capture.sequence, wanted, noise, False, light.white)
    numbers = estimate_axes(Shot(setup, light, lit), AxisOptions())
    found = {}
    shape = screen.flags.shape
    for decoder in axis_decoders(setup, numbers):
        raw = Raw(*np.empty((2, *shape), np.float32))
        shared = Shared(np.zeros(shape, np.uint16), *np.zeros((3, *shape), np.float32))
        decoder.decode(light, (0, len(screen.flags)), raw, True, shared)
        found[decoder.axis.axis] = raw
    u, v = found["u"], found["v"]
    sigmas = {"sigma_u": np.sqrt(u.variance), "sigma_v": np.sqrt(v.variance)}
    return replace(screen, u=u.coordinate, v=v.coordinate, **sigmas)


@pytest.fixture(scope="module")
def on_plane(readings: Correspondence, rig: SofastRig) -> Correspondence:
    """The readings on the rig's flat pattern, where the facet is; cells of 1 mm."""
    u, v = rig.pattern_coordinates(readings.u / COLS, 1 - readings.v / ROWS)
    seen = rig.mask & np.isfinite(u)
    scale_u, scale_v = rig.scene.pattern.cols / COLS, rig.scene.pattern.rows / ROWS
    return replace(
        readings,
        u=np.where(seen, u, np.nan),
        v=np.where(seen, v, np.nan),
        sigma_u=readings.sigma_u * scale_u,
        sigma_v=readings.sigma_v * scale_v,
        flags=np.where(seen, 0, UNSEEN).astype(np.uint16),
    )


@pytest.fixture(scope="module")
def free_form(rig: SofastRig, on_plane: Correspondence) -> HeightMap:
    """Anchored where SOFAST measured its distance."""
    return reconstruct(on_plane, rig.scene, anchor=(606.0, 606.0, 0.0))


def slopes(
    points: Floats, correspondence: Correspondence, rig: SofastRig, where: NDArray[np.bool_]
) -> Floats:
    """(2, n) slopes dz/dx, dz/dy at points (n, 3) mm: the normal halves the angle of the two rays."""
    _, rays = rig.scene.camera.rays()
    leaving = rig.scene.pattern.point(correspondence.u[where], correspondence.v[where]) - points
    normal = leaving / np.linalg.norm(leaving, axis=1, keepdims=True) - rays[where]
    return -(normal[:, :2] / normal[:, 2:]).T


def test_sigma_by_a_response_table_that_the_frames_contradict(screen: Correspondence) -> None:
    """Sigma of u is of the size of the places' scatter (second differences along
    rows), where the table alone made it 20 times as wide; the command line says so."""
    assert any("without the stated response" in notice.name for notice in screen.notices)
    u = np.where(screen.good, screen.u, np.nan)
    scatter = np.nanmedian(np.abs(np.diff(u, 2, axis=1))) / 0.6745 / np.sqrt(6)
    assert 0.5 < np.median(screen.sigma_u[screen.good]) / scatter < 2.0


def test_heights_by_the_command_line(
    real: Path, rig: SofastRig, free_form: HeightMap, screen_file: Path, tmp_path: Path
) -> None:
    """decode and reconstruct, no Python between: slopes that are SOFAST's, and the free-form solve's heights
    (which uses 28 pixels of low contrast more, and 49 that these part from the rest), to 10 um on a facet
    1.9 mm deep.
    """
    result, out = real / "sofast_facet/data_expected_facet.h5", tmp_path / "h.npz"
    slopes_file = tmp_path / "s.npz"
    args = ["reconstruct", str(screen_file), "--scene", str(result), "--out", str(out)]
    assert run([*args, "--slopes", str(slopes_file)]) == 0
    expected_height = free_form
    height, found = HeightMap.load(out), SlopeMap.load(slopes_file)
    use = rig.mask & height.good
    assert use.sum() > 0.985 * rig.mask.sum()
    np.testing.assert_allclose(height.z[use], expected_height.z[use], atol=0.01)
    error = np.stack([found.slope_x, found.slope_y])[:, use]
    error -= expected(real, "SlopeSolverData/slopes_facet_xy")[:, use[rig.mask]]
    assert np.sqrt(np.mean(error**2)) < 2e-6
    assert run([*args, "--size", "64x64"]) == 2


def edge_defects(
    height: HeightMap, correspondence: Correspondence, rig: SofastRig, use: NDArray[np.bool_]
) -> Floats:
    """Rise from pixel to pixel minus what the slopes at both ends say of it, mm, along rows and columns."""
    points = np.stack([height.x, height.y, height.z], axis=-1)
    slope = np.full((2, *use.shape), np.nan)
    slope[:, use] = slopes(points[use], correspondence, rig, use)
    defects = []
    for axis in (0, 1):
        step = np.diff(points, axis=axis)
        ends = np.diff(slope, axis=axis + 1) / 2 + np.take(slope, range(use.shape[axis] - 1), axis=axis + 1)
        defect = step[..., 2] - ends[0] * step[..., 0] - ends[1] * step[..., 1]
        defects.append(defect[np.isfinite(defect)])
    return np.concatenate(defects)


def surface_points(real: Path) -> Floats:
    """(n, 3) mm in the mirror frame: OpenCSP's points, moved so that the facet starts at 0."""
    return 1000 * expected(real, "SlopeSolverData/v_surf_points_facet").T + np.array([606.0, 606.0, 0.0])


def test_screen_fractions(real: Path, rig: SofastRig, readings: Correspondence) -> None:
    x, y = expected(real, "CalculationDataGeometryFacet/v_screen_points_fractional_screens")
    assert np.abs(readings.u[rig.mask] / COLS - x).max() < 1e-6
    assert np.abs(1 - readings.v[rig.mask] / ROWS - y).max() < 1e-6


def curvature(screen: Floats, step: int) -> Floats:
    """Sum of both second differences over so many pixels, per pixel^2; NaN where one is missing."""
    padded = np.pad(screen, step, constant_values=np.nan)
    inner = slice(step, -step)
    around = sum(np.roll(padded, step * sign, axis)[inner, inner] for sign in (-1, 1) for axis in (0, 1))
    return np.asarray((around - 4 * screen) / step**2)


def test_centres_follow_the_curvature_that_neighbours_share(real: Path, rig: SofastRig) -> None:
    """Mean and centre differ by a 24th of the curvature: of SOFAST's own map, over one pixel or more; by no
    more than a trace where its curvatures over one and two pixels contradict each other (a rough
    mirror); and by no more than sigma holds at the facet's edge. Light that falls off moves them by a
    ninth of sigma at most."""
    x, y = expected(real, "CalculationDataGeometryFacet/v_screen_points_fractional_screens")
    capture = load_sofast(real / "sofast_facet/measurement_facet.h5")
    table = load_sofast_response(real / "sofast_facet/image_calibration.h5")
    linear = Response.from_table(*table).shown_of(capture.frames)  # of one weight, as SOFAST has them
    screen = decode(linear, capture.sequence, check=False)
    maps = (screen.u, screen.sigma_u, COLS * x), (screen.v, screen.sigma_v, ROWS * (1 - y))
    for found, sigma, own in maps:
        read = np.full(rig.mask.shape, np.nan)
        read[rig.mask] = own
        moved = np.abs(found - read)
        one, two, four = (np.abs(curvature(read, step)) / 24 for step in (1, 2, 4))
        inside = np.isfinite(four)
        assert (moved <= np.maximum(one, two) + four + 1e-3 + sigma / 9)[inside].all()
        contrary = np.isfinite(two) & (np.abs(curvature(read, 1) - curvature(read, 2)) > 24 * one)
        assert contrary.sum() > 1000
        beyond = np.maximum(moved - np.nan_to_num(four) - sigma / 9, 0)[contrary]
        bend = np.maximum(one, two)[contrary]
        assert np.sqrt(np.mean(beyond**2)) < 0.05 * np.sqrt(np.mean(bend**2))
        edge = rig.mask & np.isnan(one)
        assert (moved < 1.5 * sigma)[edge].all()


def test_screen_points(real: Path, rig: SofastRig, on_plane: Correspondence) -> None:
    """The display's measured shape, and its pose: the pattern point in the optic's frame, 0.01 mm of 10 m."""
    point = rig.scene.pattern.point(on_plane.u[rig.mask], on_plane.v[rig.mask])
    camera, facet = rig.scene.camera.rays()[0][rig.mask], surface_points(real)
    screen = expected(real, "CalculationDataGeometryFacet/v_screen_points_facet").T
    aligned = screen @ expected(real, "SlopeSolverData/trans_alignment")[:3, :3].T
    assert np.abs(point - 1000 * aligned - [606, 606, 0]).max() < 0.01
    assert (np.linalg.norm(camera - facet, axis=1) > 9000).all()


def test_free_form_solve(real: Path, rig: SofastRig, on_plane: Correspondence, free_form: HeightMap) -> None:
    """Anchored where SOFAST measured its distance: slopes as its own, heights that integrate to them."""
    height = free_form
    use = rig.mask & height.good
    points = np.stack([height.x, height.y, height.z], axis=-1)[use]
    error = (
        slopes(points, on_plane, rig, use)
        - expected(real, "SlopeSolverData/slopes_facet_xy")[:, use[rig.mask]]
    )
    assert np.sqrt(np.mean(error**2)) < 2e-6  # asked for: 5 microradian rms and 30 at most
    assert np.abs(error).max() < 30e-6
    assert np.sqrt(np.mean(edge_defects(height, on_plane, rig, use) ** 2)) < 0.5e-3


@pytest.mark.parametrize("group", ["Camera", "DisplayShape", "SpatialOrientation", "DataSofastInput"])
def test_an_input_of_sofast_alone_is_refused_by_what_it_lacks(
    real: Path, tmp_path: Path, refused: Callable[..., str], group: str
) -> None:
    """SOFAST keeps camera, display, orientation and facet in files of their own, too; none is a rig."""
    alone = tmp_path / f"{group}.h5"
    with h5py.File(real / "sofast_facet/data_expected_facet.h5") as file, h5py.File(alone, "w") as part:
        file.copy(group, part)
    given = tmp_path / "c.npz"
    Correspondence(*np.ones((4, 8, 8)), flags=np.zeros((8, 8), np.uint16)).save(given)
    wanted = "no measurement (MeasurementSofastFringe/mask_images)"
    refused(["reconstruct", given, "--scene", alone, "--out", tmp_path / "h.npz"], f"{alone}: no ", wanted)


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
