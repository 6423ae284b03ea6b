"""`optolever rig new`: what it writes is the rig that the numbers say, measured on the scene it loads as."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optolever.scene import PinholeCamera, load, trace
from optolever.scene import dent as dent_of

from .conftest import Program

MONITOR = {
    "kind": "monitor",
    "mirror": "150x110",
    "display": "1920x1080",
    "diagonal": "24",
    "image": "64x48",
    "focal": "25.5",
    "pixel": "0.1",
    "angle": "30",
    "distance": "500",
    "display-distance": "400",
}
PRISM = {
    "kind": "prism",
    "mirror": "60x45",
    "display": "1080x1920",
    "pitch": "0.0234",
    "display-angle": "48",
    "bezel": "2",
    "index": "1.41",
    "image": "64x48",
    "focal": "12",
    "pixel": "0.05",
    "angle": "50",
    "distance": "120",
}


def options(values: dict[str, str]) -> list[str]:
    return [text for name, value in values.items() for text in (f"--{name}", value)]


def test_a_monitor_stands_square_to_the_reflected_line_of_sight(optolever: Program, tmp_path: Path) -> None:
    out = tmp_path / "rig.toml"
    optolever("rig", "new", *options(MONITOR), "--out", out, "--json", tmp_path / "n.json")
    rig = load(out)
    assert len([line for line in out.read_text().splitlines() if not line.startswith("#")]) <= 16
    pitch = 24 * 25.4 / math.hypot(1920, 1080)
    assert rig.pattern.pitch == pytest.approx(pitch, rel=1e-6)
    assert isinstance(rig.camera, PinholeCamera)
    assert rig.camera.focal.tolist() == [255, 255]
    middle, centre = np.array([75, 55, 0]), rig.pattern.point(959.5, 539.5)
    seen, shown = rig.camera.origin - middle, centre - middle
    assert np.linalg.norm(seen) == pytest.approx(500, abs=1e-3)
    assert np.linalg.norm(shown) == pytest.approx(400, abs=1e-3)
    assert math.degrees(math.atan2(seen[0], seen[2])) == pytest.approx(30, abs=1e-4)
    np.testing.assert_allclose(shown / 400, seen / 500 * [-1, -1, 1], atol=1e-5)  # the law of reflection
    np.testing.assert_allclose(rig.pattern.normal, shown / 400, atol=1e-5)
    numbers: dict[str, Any] = json.loads((tmp_path / "n.json").read_text())
    assert numbers["visible_share"] == pytest.approx(
        trace(rig, dent_of("flat", rig)).visible.mean(), abs=0.01
    )
    assert (tmp_path / "rig.png").stat().st_size > 5000


def test_a_prism_has_its_faces_at_their_angles(optolever: Program, tmp_path: Path) -> None:
    optolever("rig", "new", *options(PRISM), "--out", tmp_path / "rig.toml", "--picture", tmp_path / "p.svg")
    rig = load(tmp_path / "rig.toml")
    a, b = math.radians(48), math.radians(50)
    np.testing.assert_allclose(
        rig.pattern.point(-0.5, -0.5), [2 * math.cos(a), 0, 2 * math.sin(a)], atol=1e-9
    )
    np.testing.assert_allclose(rig.pattern.u_axis, [math.cos(a), 0, math.sin(a)], atol=1e-9)
    face = rig.camera.face
    assert face is not None
    np.testing.assert_allclose(face.normal, [math.sin(b), 0, math.cos(b)], atol=1e-9)
    assert (face.index, rig.medium and rig.medium.index) == (1.41, 1.41)
    origin, direction = rig.camera.rays_at(23.5, 31.5)  # square to the face it is not refracted
    np.testing.assert_allclose(direction, -face.normal, atol=1e-7)
    np.testing.assert_allclose(origin - origin[2] / direction[2] * direction, [30, 22.5, 0], atol=1e-5)
    assert (tmp_path / "p.svg").is_file()


def test_on_a_terminal_it_asks(optolever: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not given, in the order of --help; an empty answer takes the default."""
    answers = [value for name, value in PRISM.items() if name not in ("kind", "pitch", "bezel")]
    order = ("mirror", "display", "image", "focal", "pixel", "angle", "distance", "display-angle")
    given = iter([*(PRISM[name] for name in order), "", PRISM["index"]])
    asked: list[str] = []

    def answer(prompt: str) -> str:
        asked.append(prompt)
        return next(given)

    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("click.termui.visible_prompt_func", answer)
    args = ["--kind", "prism", "--pitch", PRISM["pitch"], "--out", tmp_path / "rig.toml"]
    optolever("rig", "new", *args)
    assert len(asked) == len(answers) + 1
    written = (tmp_path / "rig.toml").read_text()
    optolever("rig", "new", *options(PRISM | {"bezel": "0"}), "--out", tmp_path / "rig.toml")
    assert written == (tmp_path / "rig.toml").read_text()
