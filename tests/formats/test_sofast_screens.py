"""OpenCSP's three screen models against their published formulas (DisplayShape: rectangular2D
(fraction - 0.5) * size, distorted2D and 3D linear on the Delaunay triangles of the fractions)."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from optolever import InputError
from optolever.decode import Correspondence
from optolever.formats import SofastRig, load_sofast_rig
from optolever.scene import parameter_values

h5py = pytest.importorskip("h5py")

Floats = NDArray[np.float64]
Fields = dict[str, NDArray[np.generic] | float]

TURN = np.array([0.3, -0.2, 2.9])
SHIFT = np.array([0.4, -0.3, 1.2])  # from camera to screen, m


def h5_file(path: Path, fields: Fields) -> Path:
    with h5py.File(path, "w") as file:
        for name, value in fields.items():
            file[name] = value
    return path


def rig_fields(display: Fields, facet: str = "facet_000") -> Fields:
    """A camera in the optic frame's own pose (turned about x), a facet of 1 m x 0.5 m, 10 m away."""
    result = f"DataSofastCalculation/facet/{facet}/"
    pose = result + "CalculationDataGeometryFacet/SpatialOrientation/"
    return {
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
        **{f"DisplayShape/{key}": value for key, value in display.items()},
    }


def rig_file(path: Path, display: Fields, facet: str = "facet_000") -> Path:
    return h5_file(path, rig_fields(display, facet))


def on_screen(rig: SofastRig, x: Floats, y: Floats) -> Floats:
    """Screen coordinates (n, 3) in m of fractions, back from the scene's points by the file's own pose."""
    import cv2

    points = rig.scene.pattern.point(*rig.pattern_coordinates(x, y))
    optic = points - [500.0, 250.0, 0.0]
    to_optic = cv2.Rodrigues(np.array([np.pi, 0.0, 0.0]))[0]
    camera = optic / 1000 @ to_optic + [0.0, 0.0, 10.0]  # X_optic = R (X_cam - v)
    placed: Floats = (camera - SHIFT) @ cv2.Rodrigues(TURN)[0].T
    return placed


@pytest.mark.parametrize("model", ["rectangle", "flat", "curved"])
def test_screens(model: str, tmp_path: Path) -> None:
    """Of 2.4 m x 1 m; places are linear on the triangles of the measured fractions."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(0, 1, 8), np.linspace(0, 1, 5))
    fractions = np.column_stack([x.ravel(), y.ravel()])
    inner = ((fractions > 0) & (fractions < 1)).all(axis=1)
    fractions[inner] += 0.03 * rng.uniform(-1, 1, (inner.sum(), 2))
    places = np.pad((fractions - 0.5) * [2.4, 1.0], ((0, 0), (0, 1)))
    if model != "rectangle":
        places[:, :2] += 0.002 * rng.standard_normal((40, 2))
    if model == "curved":
        places[:, 2] = 0.1 * places[:, 0] ** 2 - 0.05 * places[:, 1]
    displays: dict[str, Fields] = {
        "rectangle": {"screen_x": 2.4, "screen_y": 1.0},
        "flat": {"xy_screen_fraction": fractions.T, "xy_screen_coords": places[:, :2].T},
        "curved": {"xy_screen_fraction": fractions.T, "xyz_screen_coords": places.T},
    }
    rig = load_sofast_rig(rig_file(tmp_path / "r.h5", displays[model]))
    at = rng.uniform(0.1, 0.9, (200, 2))
    assert np.abs(on_screen(rig, *at.T) - LinearNDInterpolator(fractions, places)(at)).max() < 1e-9
    assert not np.isfinite(rig.pattern_coordinates(np.array([1.4]), np.array([0.5]))).any()
    assert ("pattern.b20" in parameter_values(rig.scene)) == (model != "curved")


def test_facets_by_name(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = rig_file(tmp_path / "r.h5", {"screen_x": 0.7, "screen_y": 0.4}, "facet_003")
    assert load_sofast_rig(path, "facet_003").scene.mirror.length == 1000
    with pytest.raises(InputError, match=r"r\.h5: no facet 'facet_000', there are facet_003$"):
        load_sofast_rig(path)
    Correspondence(*np.ones((4, 2, 2)), np.zeros((2, 2), np.uint16)).save(tmp_path / "c.npz")
    words = ["reconstruct", str(tmp_path / "c.npz"), "--out", str(tmp_path / "h.npz"), "--scene"]
    refused([*words, f"{path},facet_007"], "no facet 'facet_007'")
    refused([*words, f"{path},facet_003"], "SOFAST rig's camera has")


def test_an_undefined_mirror_ends_at_its_outermost_pixels(tmp_path: Path) -> None:
    """10 x 20 pixels of 20 mm."""
    fields = rig_fields({"screen_x": 0.7, "screen_y": 0.4})
    known = {name: value for name, value in fields.items() if not name.endswith("v_facet_corners")}
    rig = load_sofast_rig(h5_file(tmp_path / "r.h5", known))
    assert (rig.scene.mirror.length, rig.scene.mirror.width) == pytest.approx((380, 180))


def inputs(folder: Path, distance: float = 9.0, name: str = "optic_screen_dist") -> list[Path]:
    """A camera at the origin that looks along z, the screen beside it, a measurement, each in a file."""
    frames = np.zeros((40, 60, 2), np.uint8)
    frames[8:31, 10:51, 1] = 200
    frames[2:4, 2:4, 1] = 250  # a reflection elsewhere
    parts: dict[str, Fields] = {
        "Camera": {
            "intrinsic_mat": np.array([[600.0, 0, 25], [0, 610.0, 22], [0, 0, 1]]),
            "distortion_coef": np.array([-0.1, 0.02, 1e-3, -1e-3, 0.0]),
            "image_shape_xy": np.array([60, 40]),
        },
        "DisplayShape": {"screen_x": 0.7, "screen_y": 0.4},
        "SpatialOrientation": {"r_cam_screen": TURN, "v_cam_screen_cam": SHIFT[:, None]},
        "MeasurementSofastFringe": {
            "mask_images": frames,
            name: distance,
            "v_measure_point_facet": np.array([0.1, -0.05, 0.002]),
        },
    }
    return [
        h5_file(folder / f"{part}.h5", {f"{part}/{key}": value for key, value in fields.items()})
        for part, fields in parts.items()
    ]


FACET_JSON = """{
  "v_facet_corners": {"x": [0.4, -0.2, -0.2, 0.4], "y": [-0.1, -0.1, 0.3, 0.3], "z": [0, 0, 0, 0]},
  "v_centroid_facet": {"x": [0.1], "y": [0.1], "z": [0.0]}
}"""


@pytest.mark.parametrize("defined", [True, False])
@pytest.mark.parametrize("name", ["optic_screen_dist", "dist_optic_screen"])
def test_inputs_are_a_rig(defined: bool, name: str, tmp_path: Path) -> None:
    """From the formulas: the pixel amid the lit ones sees the centroid, from there camera and screen's centre
    lie on both sides of the normal, the measured point is as far from the screen's centre as was measured."""
    import cv2

    paths = inputs(tmp_path, name=name)
    if defined:
        (tmp_path / "facet.json").write_text(FACET_JSON)
        paths.append(tmp_path / "facet.json")
    rig = load_sofast_rig(paths)
    scene, camera = rig.scene, rig.scene.camera
    rotation = np.stack([camera.u_axis, camera.v_axis, np.cross(camera.u_axis, camera.v_axis)], axis=1)
    to_mirror = lambda point: rotation @ (1000 * np.asarray(point)) + camera.origin  # noqa: E731
    screen = to_mirror(SHIFT)
    turn = cv2.Rodrigues(TURN)[0]  # camera to screen
    centre = scene.pattern.point(*rig.pattern_coordinates(np.array([0.5]), np.array([0.5])))[0]
    assert np.abs(centre - screen).max() < 1e-6
    assert np.abs(scene.pattern.u_axis - rotation @ turn.T[:, 0]).max() < 1e-9
    o, d = camera.rays_at(19.0, 30.0)
    lens = np.array([[600.0, 0, 25], [0, 610.0, 22], [0, 0, 1]])
    seen = cv2.undistortPoints(np.array([[30.0, 19.0]]), lens, np.array([-0.1, 0.02, 1e-3, -1e-3, 0.0]))
    expected = to_mirror([*seen.ravel(), 1.0]) - camera.origin
    assert np.abs(d - expected / np.linalg.norm(expected)).max() < 1e-6
    middle = o - o[2] / d[2] * d
    ways = [(end - middle) / np.linalg.norm(end - middle) for end in (camera.origin, screen)]
    assert np.abs((ways[0] + ways[1])[:2]).max() < 1e-9
    assert camera.u_axis[1] == pytest.approx(0, abs=1e-9)
    assert camera.u_axis[0] > 0.9 > 0 > camera.v_axis[1]
    assert np.linalg.norm(np.array(rig.datum) - screen) == pytest.approx(9000)
    origin = np.array(rig.datum) - [100, -50, 2]
    assert (rig.mask.sum(), rig.mask[3, 3], rig.mask[8, 10]) == (23 * 41, False, True)
    if defined:
        assert np.abs(middle - origin - [100, 100, 0]).max() < 1e-6
        assert np.abs(origin - [200, 100, 0]).max() < 1e-6
        assert (scene.mirror.length, scene.mirror.width) == pytest.approx((600, 400))
    else:
        assert np.abs(middle - origin).max() < 1e-6
        assert 500 < scene.mirror.length < 700


def definition(text: str, tmp_path: Path) -> list[Path]:
    (tmp_path / "facet.json").write_text(text)
    return [*inputs(tmp_path), tmp_path / "facet.json"]


def without(part: int, tmp_path: Path) -> list[Path]:
    paths = inputs(tmp_path)
    del paths[part]
    return paths


def dark(tmp_path: Path) -> list[Path]:
    paths = inputs(tmp_path)
    with h5py.File(paths[3], "a") as file:
        file["MeasurementSofastFringe/mask_images"][...] = 7
    return paths


def screen(tmp_path: Path, **display: NDArray[np.generic] | float) -> list[Path]:
    return [rig_file(tmp_path / "r.h5", {**display})]


#: Files, and what the message says of them.
REFUSED: list[tuple[Callable[[Path], list[Path]], str]] = [
    (partial(without, 0), "no Camera/intrinsic_mat"),
    (partial(without, 1), "DisplayShape has none of the screen models"),
    (partial(without, 2), "no SpatialOrientation/r_cam_screen"),
    (partial(without, 3), "no MeasurementSofastFringe/mask_images"),
    (lambda folder: inputs(folder)[:1], "no MeasurementSofastFringe/mask_images"),
    (partial(definition, '{"v_facet_corners": {"x": [0]}}'), r"facet\.json: no definition of one facet"),
    (partial(definition, "[1"), r"facet\.json: no definition of one facet"),
    (partial(definition, '{"v_facet_locations": {}}'), r"facet\.json: no definition of one facet"),
    (partial(definition, FACET_JSON.replace("0.3, 0.3", "0.3, NaN")), "v_facet_corners has values"),
    (lambda folder: inputs(folder, 0.1), r"dist_optic_screen = 0\.1: no point in view"),
    (dark, "white is nowhere brighter"),
    (screen, "none of the screen models: screen_x"),
    (partial(screen, screen_x=0.7), "none of the screen models"),
    (partial(screen, xy_screen_fraction=np.ones((2, 4)), xy_screen_coords=np.ones((2, 5))), "n >= 3 places"),
]


@pytest.mark.parametrize(("files", "message"), REFUSED)
def test_refused(files: Callable[[Path], list[Path]], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        load_sofast_rig(files(tmp_path))


WHOLE = rig_fields({"xy_screen_fraction": np.eye(2, 4), "xy_screen_coords": np.eye(2, 4)})


@pytest.mark.parametrize("value", [1.0, np.ones((2, 3, 4)), np.ones((2, 0)), np.full((3, 1), 1e300)])
def test_fields_of_another_shape(value: NDArray[np.generic] | float, tmp_path: Path) -> None:
    for name in (*WHOLE, "DataSofastCalculation/facet/facet_000/SlopeSolverData/trans_alignment"):
        path = h5_file(tmp_path / "r.h5", WHOLE | {name: value})
        with pytest.raises(InputError, match=rf"r\.h5: .*{name.rpartition('/')[2]}"):
            load_sofast_rig(path)
