"""`optolever rig new`: what it writes is the rig that the numbers say, measured on the scene it loads as."""

import json
import math
import shlex
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest

from optolever.scene import PinholeCamera, load, trace
from optolever.scene import dent as dent_of

from .conftest import Program

MONITOR = shlex.split(
    "--kind monitor --mirror 150x110 --display 1920x1080 --diagonal 24 --image 64x48 --view-distance 510 "
    "--view-width 128 --angle 30 --distance 500 --display-distance 400"
)
PRISM = shlex.split(
    "--kind prism --diagonal 2.0295 --mirror 60x45 --display 1080x1920 --image 64x48 --view-distance 240 "
    "--view-width 64 --angle 50 --distance 120 --display-angle 48 --index 1.41"
)


def test_a_monitor_stands_square_to_the_reflected_line_of_sight(optolever: Program, tmp_path: Path) -> None:
    out = tmp_path / "rig.toml"
    optolever("rig", "new", *MONITOR, "--out", out, "--json", tmp_path / "n.json")
    rig = load(out)
    assert rig.pattern.pitch == pytest.approx(24 * 25.4 / math.hypot(1920, 1080), rel=1e-6)
    assert isinstance(rig.camera, PinholeCamera)
    assert rig.camera.focal.tolist() == [255, 255]
    middle, centre = np.array([75, 55, 0]), rig.pattern.point(959.5, 539.5)
    seen, shown = rig.camera.origin - middle, centre - middle
    assert np.linalg.norm(seen) == pytest.approx(500, abs=1e-3)
    assert math.degrees(math.atan2(seen[0], seen[2])) == pytest.approx(30, abs=1e-4)
    np.testing.assert_allclose(shown / 400, seen / 500 * [-1, -1, 1], atol=1e-5)  # the law of reflection
    np.testing.assert_allclose(rig.pattern.normal, shown / 400, atol=1e-5)
    numbers: dict[str, Any] = json.loads((tmp_path / "n.json").read_text())
    share = trace(rig, dent_of("flat", rig)).visible.mean()
    assert numbers["visible_share"] == pytest.approx(share, abs=0.01)
    drawn = (tmp_path / "rig.png").read_bytes()
    assert len(drawn) > 5000
    with matplotlib.rc_context({"text.usetex": True, "font.size": 30}):  # of a user's matplotlibrc
        optolever("rig", "new", *MONITOR, "--out", out)
    assert (tmp_path / "rig.png").read_bytes() == drawn


def test_a_prism_has_its_faces_at_their_angles(optolever: Program, tmp_path: Path) -> None:
    out = tmp_path / "rig.toml"
    optolever("rig", "new", *PRISM, "--bezel", "2", "--out", out)
    rig = load(out)
    a, b = math.radians(48), math.radians(50)
    across = 0.5 * (45 - 1920 * 2.0295 * 25.4 / math.hypot(1080, 1920))  # centred
    corner = [2 * math.cos(a), across, 2 * math.sin(a)]
    np.testing.assert_allclose(rig.pattern.point(-0.5, -0.5), corner, atol=1e-9)
    np.testing.assert_allclose(rig.pattern.u_axis, [math.cos(a), 0, math.sin(a)], atol=1e-9)
    face = rig.camera.face
    assert face is not None
    np.testing.assert_allclose(face.normal, [math.sin(b), 0, math.cos(b)], atol=1e-9)
    assert (face.index, rig.medium and rig.medium.index) == (1.41, 1.41)
    origin, direction = rig.camera.rays_at(23.5, 31.5)  # square to the face it is not refracted
    np.testing.assert_allclose(direction, -face.normal, atol=1e-7)
    np.testing.assert_allclose(origin - origin[2] / direction[2] * direction, [30, 22.5, 0], atol=1e-5)
    drawn = {line.get_label(): line.get_xydata() for line in rig.plot().lines}
    np.testing.assert_allclose(drawn["camera"], np.broadcast_to(rig.camera.origin[::2], (9, 2)))
    optolever("rig", "new", *PRISM, "--bezel", "2", "--across", "-1.5", "--out", out)
    np.testing.assert_allclose(load(out).pattern.point(-0.5, -0.5)[1], -1.5, atol=1e-9)
