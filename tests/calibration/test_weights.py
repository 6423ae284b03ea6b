"""Young's modulus of a layer by known weights, against Hertz in closed form."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.calibration import Weight, weighed
from optolever.cli import run
from optolever.reconstruct import HeightMap
from optolever.scene import Layer, load

RADIUS, MODULUS = 20.0, 0.25  # mm, N/mm^2
GUESS = Layer(1.0, 0.45)
PLANE = MODULUS / (1 - GUESS.poisson**2)


def pressed(edge: float, sigma: float = 1e-4, seed: int = 0) -> tuple[HeightMap, float]:
    """Height around a rigid ball's contact of radius `edge`, mm, and its force (K. L. Johnson, Contact
    Mechanics, 1985, eq. 3.41, 3.42: d = a^2 / R, F = 4/3 E* a d)."""
    x, y = np.meshgrid(np.arange(0, 40, 0.1), np.arange(0, 30, 0.1))
    depth, q = edge**2 / RADIUS, np.hypot(x - 21.3, y - 14.2) / edge
    out = np.maximum(q, 1.0)
    beyond = ((2 - out**2) * np.arcsin(1 / out) + np.sqrt(out**2 - 1)) / math.pi
    z = depth * np.where(q <= 1, 1 - q**2 / 2, beyond)
    common = sigma * np.random.default_rng(seed).standard_normal()
    flat = np.zeros(z.shape, np.uint16)
    return HeightMap(x, y, z + common, np.full(z.shape, sigma), flat), 4 / 3 * PLANE * edge * depth


@pytest.mark.parametrize("edge", [1.0, 2.0, 4.0])
def test_the_modulus_is_that_of_hertz(edge: float) -> None:
    height, newton = pressed(edge)
    found = weighed(GUESS, [Weight(height, newton)])
    assert found.layer.youngs_modulus_mpa == pytest.approx(MODULUS, rel=0.003)
    assert 0 < found.layer.youngs_modulus_sigma_mpa < 0.05 * MODULUS
    assert found.layer.poisson == GUESS.poisson


@pytest.mark.slow
def test_several_weights_and_their_errors() -> None:
    """They average, the scatter of 20 drawn sets is sigma; a contradiction widens it."""
    maps = [pressed(edge, 1e-9) for edge in (2.0, 2.5, 3.0, 3.5)]
    rng, drawn = np.random.default_rng(1), []
    for _ in range(20):
        errors = 1 + 0.1 * rng.standard_normal(len(maps))
        weights = [Weight(h, f * e, 0.1 * f) for (h, f), e in zip(maps, errors, strict=True)]
        drawn.append(weighed(GUESS, weights))
    moduli = np.array([one.layer.youngs_modulus_mpa for one in drawn])
    sigma = np.array([one.sigmas for one in drawn]).mean() / 2
    assert np.std(moduli) == pytest.approx(sigma, rel=0.4)
    assert moduli.mean() == pytest.approx(MODULUS, rel=0.05)
    wrong = weighed(GUESS, [Weight(h, f * (2 if k else 1), 0.01 * f) for k, (h, f) in enumerate(maps)])
    assert wrong.chi > 10
    assert wrong.layer.youngs_modulus_sigma_mpa > 0.05 * MODULUS


def test_what_is_no_weight_is_refused() -> None:
    height, newton = pressed(2.0)
    still = Weight(replace(height, z=np.zeros(height.z.shape)), newton)
    for weight, words in ((Weight(height, -1.0), "weight: -1 ± 0 N, must be above 0"), (still, "less rest")):
        with pytest.raises(InputError, match=words):
            weighed(GUESS, [weight])


def test_calibrate_by_weights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The rig gets the modulus with sigma, and is loaded again; a weight without its map is one line."""
    rig, out, numbers = (tmp_path / name for name in ("rig.toml", "weighed.toml", "w.json"))
    replace(load("prism48"), layer=GUESS).save(rig)
    words = ["calibrate", "--scene", str(rig), "--out", str(out)]
    for k, edge in enumerate((2.0, 3.0)):
        height, newton = pressed(edge)
        height.save(tmp_path / f"h{k}.npz")
        words += ["--weight", f"{newton:.6f},{0.001 * newton:.6f}={tmp_path}/h{k}.npz"]
    assert run([*words, "--json", str(numbers)]) == 0
    layer = load(out).layer
    assert layer is not None
    assert abs(layer.youngs_modulus_mpa - MODULUS) < 3 * layer.youngs_modulus_sigma_mpa < 0.01 * MODULUS
    assert json.loads(numbers.read_text())["youngs_modulus_mpa"] == layer.youngs_modulus_mpa
    capsys.readouterr()
    for weight, said in (("0.5", "must be NEWTON[,SIGMA]=H.npz"), ("x=h.npz", "must be NEWTON[,SIGMA]")):
        assert run([*words[:5], "--weight", weight]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line
