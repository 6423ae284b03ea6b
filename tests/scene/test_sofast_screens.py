"""OpenCSP's three screen models against their published formulas (DisplayShape: rectangular2D
(fraction - 0.5) * size, distorted2D and 3D linear on the Delaunay triangles of the fractions)."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from optolever import InputError
from optolever.scene import SofastRig, load_sofast_rig, parameter_values

h5py = pytest.importorskip("h5py")

Floats = NDArray[np.float64]
Fields = dict[str, NDArray[np.generic] | float]

TURN = np.array([0.3, -0.2, 2.9])
SHIFT = np.array([0.4, -0.3, 1.2])  # from camera to screen, m


def rig_file(path: Path, display: Fields, facet: str = "facet_000") -> Path:
    """A camera in the optic frame's own pose (turned about x), a facet of 1 m x 0.5 m, 10 m away."""
    result = f"DataSofastCalculation/facet/{facet}/"
    pose = result + "CalculationDataGeometryFacet/SpatialOrientation/"
    fields: Fields = {
        "Camera/intrinsic_mat": np.diag([500.0, 500.0, 1.0]),
        "Camera/distortion_coef": np.zeros(5),
        "Camera/image_shape_xy": np.array([20, 10]),
        pose + "r_cam_optic": np.array([np.pi, 0.0, 0.0]),
        pose + "v_cam_optic_cam": np.array([0.0, 0.0, 10.0]),
        pose + "r_cam_screen": TURN,
        pose + "v_cam_screen_cam": SHIFT,
        f"DataSofastInput/optic_definition/{facet}/DefinitionFacet/v_facet_corners": np.array(
            [[-0.5, 0.5, 0.5, -0.5], [-0.25, -0.25, 0.25, 0.25], [0.0, 0.0, 0.0, 0.0]]
        ),
        result + "CalculationImageProcessingFacet/mask_processed": np.ones((10, 20), bool),
    }
    with h5py.File(path, "w") as file:
        for name, value in (
            fields | {f"DisplayShape/{key}": value for key, value in display.items()}
        ).items():
            file[name] = value
    return path


def on_screen(rig: SofastRig, x: Floats, y: Floats) -> Floats:
    """Screen coordinates (n, 3) in m of fractions, back from the scene's points by the file's own pose."""
    import cv2

    points = rig.scene.pattern.point(*rig.pattern_coordinates(x, y))
    optic = points - [500.0, 250.0, 0.0]
    to_optic = cv2.Rodrigues(np.array([np.pi, 0.0, 0.0]))[0]
    camera = optic / 1000 @ to_optic + [0.0, 0.0, 10.0]  # X_optic = R (X_cam - v)
    placed: Floats = (camera - SHIFT) @ cv2.Rodrigues(TURN)[0].T
    return placed


def linear_on_triangles(fractions: Floats, values: Floats, at: Floats) -> Floats:
    """Barycentric, from the triangles alone."""
    triangles = Delaunay(fractions)
    which = triangles.find_simplex(at)
    transform = triangles.transform[which]
    first = np.einsum("nij,nj->ni", transform[:, :2], at - transform[:, 2])
    weights = np.column_stack([first, 1 - first.sum(axis=1)])
    found: Floats = np.einsum("ni,nij->nj", weights, values[triangles.simplices[which]])
    return found


@pytest.fixture
def measured() -> tuple[Floats, Floats]:
    """Fractions (40, 2) and places (40, 3) m of a curved screen of 2.4 m x 1 m."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(0, 1, 8), np.linspace(0, 1, 5))
    fractions = np.column_stack([x.ravel(), y.ravel()])
    inner = ((fractions > 0) & (fractions < 1)).all(axis=1)
    fractions[inner] += 0.03 * rng.uniform(-1, 1, (inner.sum(), 2))
    places = (fractions - 0.5) * [2.4, 1.0] + 0.002 * rng.standard_normal((40, 2))
    return fractions, np.column_stack([places, 0.1 * places[:, 0] ** 2 - 0.05 * places[:, 1]])


def inside() -> Floats:
    return np.random.default_rng(0).uniform(0.1, 0.9, (200, 2))


def test_rectangular(tmp_path: Path) -> None:
    rig = load_sofast_rig(rig_file(tmp_path / "r.h5", {"screen_x": 0.7, "screen_y": 0.4}))
    at = inside()
    expected = np.column_stack([(at - 0.5) * [0.7, 0.4], np.zeros(len(at))])
    assert np.abs(on_screen(rig, *at.T) - expected).max() < 1e-9


@pytest.mark.parametrize("flat", [True, False])
def test_distorted(measured: tuple[Floats, Floats], flat: bool, tmp_path: Path) -> None:
    fractions, places = measured
    places = places * [1, 1, 0] if flat else places
    name = "xy_screen_coords" if flat else "xyz_screen_coords"
    display: Fields = {"xy_screen_fraction": fractions.T, name: places[:, : 2 if flat else 3].T}
    rig = load_sofast_rig(rig_file(tmp_path / "r.h5", display))
    at = inside()
    assert np.abs(on_screen(rig, *at.T) - linear_on_triangles(fractions, places, at)).max() < 1e-9
    outside = rig.pattern_coordinates(np.array([1.4]), np.array([0.5]))
    assert not np.isfinite(outside).any()


def test_rays_land_on_a_screen_that_is_not_flat(measured: tuple[Floats, Floats], tmp_path: Path) -> None:
    fractions, places = measured
    display: Fields = {"xy_screen_fraction": fractions.T, "xyz_screen_coords": places.T}
    pattern = load_sofast_rig(rig_file(tmp_path / "r.h5", display)).scene.pattern
    cells = pattern.cols * inside()
    u, v = cells.T
    on = np.isfinite(pattern.point(u, v)).all(axis=-1)
    points = pattern.point(u[on], v[on]).T
    start = points + 3000 * pattern.normal[:, None] + 200 * pattern.u_axis[:, None]
    along = (points - start) / np.linalg.norm(points - start, axis=0)
    found = pattern.landing(start, along)
    assert on.sum() > 30
    assert np.abs(found[0] - u[on]).max() < 1e-6
    assert np.abs(found[1] - v[on]).max() < 1e-6
    assert "pattern.b20" not in parameter_values(load_sofast_rig(tmp_path / "r.h5").scene)


def test_facets_by_name(tmp_path: Path) -> None:
    path = rig_file(tmp_path / "r.h5", {"screen_x": 0.7, "screen_y": 0.4}, "facet_003")
    assert load_sofast_rig(path, "facet_003").scene.mirror.length == 1000
    with pytest.raises(InputError, match=r"r\.h5: field .*facet_000.* is missing"):
        load_sofast_rig(path)


def test_undefined_mirrors_are_told(tmp_path: Path) -> None:
    path = rig_file(tmp_path / "r.h5", {"screen_x": 0.7, "screen_y": 0.4})
    with h5py.File(path, "a") as file:
        del file["DataSofastInput"]
    with pytest.raises(InputError, match=r"v_facet_corners.* is missing") as error:
        load_sofast_rig(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("display", "told"),
    [
        ({}, "none of the screen models .*rectangular2D: .*screen_x"),
        ({"screen_x": 0.7}, "none of the screen models"),
        ({"screen_x": -0.7, "screen_y": 0.4}, "screen_x = -0.7, must be above 0 m"),
        ({"xy_screen_fraction": np.ones((2, 4)), "xy_screen_coords": np.ones((2, 5))}, "n >= 3 places"),
    ],
)
def test_other_screens_are_refused(display: Fields, told: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=told):
        load_sofast_rig(rig_file(tmp_path / "r.h5", display))
