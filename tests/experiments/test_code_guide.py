"""`optolever lab codes`: what is predicted is what a simulation gives; what is called detected is."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import erfc

from optolever import InputError
from optolever.cli import run
from optolever.decode import decode
from optolever.experiments import code_rows, predict_code, seen
from optolever.patterns import sequence_from_text

SIZE = (120, 170)


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        pytest.param("gray", 0.06, marks=pytest.mark.slow),
        pytest.param("long-run-gray", 0.06, marks=pytest.mark.slow),
        ("phase:steps=4", 0.05),
        pytest.param("phase:steps=3,periods=20/22/25", 0.05, marks=pytest.mark.slow),
        ("gray+phase", 0.05),
        pytest.param("micro-phase", 0.12, marks=pytest.mark.slow),
        pytest.param("stripe:step=8", 0.06, marks=pytest.mark.slow),
    ],
)
def test_predicted_sigma_is_the_scatter_of_a_simulation(name: str, tolerance: float) -> None:
    shown = sequence_from_text(name, *SIZE)
    rng = np.random.default_rng(2)
    row, col = np.mgrid[:100, :140].astype(float)
    u, v = 14 + col + 0.03 * row, 9 + row - 0.04 * col  # flat: these pixels have no area
    found = decode(seen(shown, u, v, 60.0, 2.0, rng), shown, on_cells=False)
    _, sigma, _, _ = predict_code(shown, 60.0, 2.0)
    scatter = [float(np.std((at - true)[found.good])) for at, true in ((found.u, u), (found.v, v))]
    assert found.good.mean() > 0.9
    assert max(scatter) == pytest.approx(sigma, rel=tolerance)


@pytest.mark.parametrize("name", [pytest.param("spot:step=8", marks=pytest.mark.slow), "spot:step=16"])
def test_predicted_sigma_of_spots_is_a_bound_that_is_nearly_reached(name: str) -> None:
    shown = sequence_from_text(name, *SIZE)
    row, col = np.mgrid[:100, :140].astype(float)
    u, v = 14 + col + 0.03 * row, 9 + row - 0.04 * col
    found = decode(seen(shown, u, v, 60.0, 2.0, np.random.default_rng(2)), shown)
    _, sigma, _, _ = predict_code(shown, 60.0, 2.0)
    for at, true in ((found.u, u), (found.v, v)):
        assert 0.99 < float(np.std((at - true)[found.good])) / sigma < 1.13


@pytest.mark.parametrize(("ratio", "name"), [(2.0, "gray+phase:steps=4"), (2.2, "gray")])
def test_predicted_rate_of_wrong_bits(ratio: float, name: str) -> None:
    shown = sequence_from_text(f"{name}{',' if ':' in name else ':'}axes=u", *SIZE)
    rng = np.random.default_rng(3)
    cell = next(frame.cell_px for frame in shown.frames if frame.bit is not None)
    # centres of cells: nearer to their edges the code alone is no better, and the fringe mends it
    u = (rng.integers(2, 160 // cell, (150, 200)) + 0.5) * cell - 0.5
    frames = seen(shown, u, u, 60.0, 60.0 / ratio, rng)
    found = decode(frames, shown, on_cells=False)
    wrong = float((np.abs(found.u - u) > 1.5 * cell).mean())
    _, _, gross, _ = predict_code(shown, 60.0, 60.0 / ratio)
    assert wrong == pytest.approx(gross, rel=0.25)


def test_predicted_rate_of_wrong_orders() -> None:
    """Two periods that differ by one count: erfc(pi / (sqrt 2 sigma_phi sqrt(v1^2 + v2^2)))."""
    shown = sequence_from_text("phase:steps=4,counts=9/10,axes=u", 100, 900)
    ratio = 4.0
    sigma = np.sqrt(2 / 4) / ratio
    expected = erfc(np.pi / (np.sqrt(2) * sigma * np.sqrt(81 + 100)))
    _, _, gross, _ = predict_code(shown, ratio, 1.0)
    # the ends of the surface have neighbours on one side only
    assert 0.8 * expected < gross <= 1.05 * expected


def test_rows_and_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "codes.json"
    names = ["gray+phase", "phase:steps=3", "phase:steps=3,counts=0.9"]
    assert run(["codes", *names, "--size", "120x170", "--json", str(path)]) == 0
    rows = json.loads(path.read_text())["codes"]
    assert [row["name"] for row in rows] == names
    assert rows[0]["frames"] == 21
    for row in rows[:2]:  # two steps of one period contradict the other period
        assert row["lost"] == row["swapped"] == 1.0
    assert rows[2]["swapped"] < 1.0  # of one period alone: another mirror
    assert "gray+phase" in capsys.readouterr().out


def test_bad_numbers() -> None:
    with pytest.raises(InputError, match="noise is 0"):
        list(code_rows(["gray"], SIZE, 60.0, 0.0))
    with pytest.raises(InputError, match="name is 'grey'"):
        list(code_rows(["grey"], SIZE, 60.0, 1.0))
