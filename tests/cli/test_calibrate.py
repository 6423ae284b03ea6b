"""`optolever calibrate`: from captures to a rig that `reconstruct` takes; what is refused."""

import json
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from lab.calibration.rigs import Rig, correspondence_of, open_air
from optolever.calibration import default_priors, load_response
from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap
from optolever.scene import Display, load, resize, rig_table

from .conftest import Program, Refused


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rig, Path]:
    folder = tmp_path_factory.mktemp("captures")
    rng = np.random.default_rng(3)
    rig = open_air(rng, 4, correspondence_of(0.0016, rng), size=60)
    rig.given.save(folder / "given.toml")
    for each in rig.observations:
        each.correspondence.save(folder / f"{each.name}.npz")
    return rig, folder


def test_from_captures_to_heights_with_modes(
    rig: tuple[Rig, Path], tmp_path: Path, optolever: Program
) -> None:
    folder = rig[1]
    flats = [f"flat:1e-6={folder}/flat{k}.npz" for k in range(4)]
    out, numbers, page = tmp_path / "rig.toml", tmp_path / "rig.json", tmp_path / "rig.html"
    files = ("--out", out, "--json", numbers, "--report", page)
    outcome = optolever("calibrate", *flats, "--scene", folder / "given.toml", "--without", "flat3", *files)
    html, found, scene = page.read_text(), json.loads(numbers.read_text()), load(out)
    for text in ("flat2: chi", "flatness adds to the heights", "Correlations", "difference of maps"):
        assert text in html
    assert "camera.f" in outcome.out
    assert "z = 0 is the mirror of the first" in outcome.err
    assert set(found["captures"]) == {"flat0", "flat1", "flat2"}
    assert scene.covariance is not None
    assert f"Calibrated on {date.today().isoformat()}" in html
    solve = ("--scene", out, "--out", tmp_path / "h.npz", "--anchor", "75,55,0")
    outcome = optolever("reconstruct", folder / "flat0.npz", *solve, "--json", numbers)
    assert " rig (medians)" in outcome.out
    budget = json.loads(numbers.read_text())["budget_mm"]["height (deepest)"]
    assert budget["total"] > budget["noise of the calibration's captures"] > 0
    modes = HeightMap.load(tmp_path / "h.npz").calibration
    assert modes is not None
    assert len(modes) == len(scene.covariance.root)
    optolever("reconstruct", folder / "flat0.npz", *solve, "--keep-rest")
    for words, against in (((), True), (("--no-rest",), False)):
        optolever("reconstruct", folder / "flat1.npz", *solve, *words)
        assert HeightMap.load(tmp_path / "h.npz").against_rest == against


@pytest.mark.slow
def test_a_number_far_from_its_typed_value_is_not_written(
    rig: tuple[Rig, Path], tmp_path: Path, optolever: Program
) -> None:
    folder, out = rig[1], tmp_path / "rig.toml"
    flats = [f"flat:1e-6={folder}/flat{k}.npz" for k in range(4)]
    words = ("--scene", str(folder / "given.toml"), "--out", str(out), "--prior", "camera.f=0.1")
    outcome = optolever("calibrate", *flats, *words, code=2)
    assert all(text in outcome.err for text in ("rig.toml", "camera.f is", "+- 0.1", "at most 5"))
    assert not any(tmp_path.iterdir())
    optolever("calibrate", *flats, *words, "--accept")
    assert load(out).covariance is not None


def test_a_response_is_kept_and_decoded_by(tmp_path: Path, optolever: Program, refused: Refused) -> None:
    """Three steps under gamma 2.2: half a cell of sigma without the rig's response, a tenth of it with it."""
    scene, rig = resize(load("monitor-mirror"), 64, 80), tmp_path / "rig.toml"
    scene = replace(scene, display=Display(2.2))
    scene.save(rig)
    for name, text in (("ramp", "ramp"), ("fringes", "gray+phase"), ("three", "phase:steps=3")):
        capture = ("--scene", str(rig), "--sequence", text, "--noise", "1", "--out", str(tmp_path / name))
        optolever("simulate", *capture)
    paths = [str(tmp_path / name) for name in ("ramp", "fringes")]
    numbers = tmp_path / "n.json"
    decode = ("decode", str(tmp_path / "three"), "--out", str(tmp_path / "c.npz"), "--json", str(numbers))
    optolever(*decode)
    alone = Correspondence.load(tmp_path / "c.npz")
    refused([*decode, "--response", rig], "optolever response")
    optolever("response", *paths, "--scene", str(rig), "--json", str(numbers))
    told = json.loads(numbers.read_text())
    assert told["gamma"] == pytest.approx(2.2, abs=0.02)
    assert told["blur_px"] == pytest.approx(scene.pattern.blur_px, rel=0.05)
    optolever(*decode, "--response", str(rig))
    assert json.loads(numbers.read_text())["good_share"] > 0.9
    known = Correspondence.load(tmp_path / "c.npz")
    assert np.median(known.sigma_u[known.good]) < 0.1 * np.median(alone.sigma_u[alone.good])
    rig.write_text(rig.read_text() + '\n[devices]\ncamera = "virtual"\n[profile]\nfile = "p.npz"\n')
    sigmas, out = [], tmp_path / "elsewhere/out.toml"
    out.parent.mkdir()
    held = [f"--prior={name}={0.1 * (name == 'pattern.z')}" for name in default_priors(load(rig))]
    for flat in (tmp_path / "three", tmp_path / "c.npz"):
        said = optolever("calibrate", f"flat={flat}", "--scene", rig, "--out", out, *held, "--accept").err
        assert "does not use [profile]" in " ".join(said.split())
        covariance = load(out).covariance
        assert covariance is not None
        sigmas.append(np.sqrt(np.diag(covariance.matrix)))
    np.testing.assert_allclose(*sigmas, rtol=1e-9)
    kept = rig_table(out)
    assert kept["devices"] == {"camera": "virtual"}
    assert load_response(out).gamma[0] == pytest.approx(told["gamma"])
