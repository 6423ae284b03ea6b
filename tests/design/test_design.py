"""Design and sensor maps on small scenes: against Monte Carlo, formulas and the truth."""

import json
import math
import sys
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from optolever.cli import run
from optolever.design import (
    Candidate,
    Lever,
    Tradeoff,
    condition_panels,
    predict,
    sensor_maps,
    user_candidate,
    write_tradeoff_chart,
)
from optolever.errors import InputError
from optolever.patterns import sequence, sequence_from_text
from optolever.scene import Scene, dent, load, resize


@pytest.fixture(scope="module")
def prism() -> Scene:
    return resize(load("prism48", exact=True), 72, 96)


@pytest.fixture(scope="module")
def lever(prism: Scene) -> Lever:
    return Lever(prism, dent("gaussian", prism, peak=0.3, sigma=8))


@pytest.mark.daily(2)
@pytest.mark.parametrize(
    "text",
    [
        "gray+phase:period=8",
        "phase:steps=3,periods=101/4",
        "phase:steps=6,periods=10.2/9.7",
        "stripe:step=32",
    ],
)
def test_predicted_height_error_is_that_of_a_simulation(lever: Lever, text: str) -> None:
    """Frames of the virtual sensor in eight draws of noise, whose rms error scatters by a fifth."""
    shown = sequence_from_text(text, lever.scene.pattern.rows, lever.scene.pattern.cols)
    there = predict(lever.view, shown, 1.0)
    told = lever.height(there)
    found = lever.simulate(Candidate(text, shown), 1.0, range(8), "numpy")
    assert told.total == pytest.approx(found.error, rel=0.2)
    assert told.spread < 0.06
    assert found.share == pytest.approx(told.share, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "size", "bump", "stride", "within"),
    [
        pytest.param("prism48", (144, 192), (0.3, 6), 3, 0.15, id="small"),
        pytest.param("prism48", (144, 192), (0.3, 8), 3, 0.15, id="middle"),
        pytest.param("prism48", (144, 192), (0.3, 12), 3, 0.1, id="wide"),
        # reaches the pattern's edge, where errors grow without limit
        pytest.param("paper-simulation", (192, 192), (0.6, 25), 4, 0.1, id="edge"),
    ],
)
def test_a_thinned_camera_predicts_the_full_one(
    scene: str, size: tuple[int, int], bump: tuple[float, float], stride: int, within: float
) -> None:
    """Every third or fourth pixel: the same height error, of narrow dents an eighth less."""
    camera = resize(load(scene, exact=True), *size)
    surface = dent("gaussian", camera, peak=bump[0], sigma=bump[1])
    shown = sequence("gray+phase", camera.pattern.rows, camera.pattern.cols)
    sizes = []
    for each in (1, stride):
        lever = Lever(camera, surface, stride=each)
        sizes.append(lever.height(predict(lever.view, shown, 1.0)).total)
    assert sizes[1] == pytest.approx(sizes[0], rel=within)


def test_user_patterns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A callable of the working folder (which a console script's path does not hold), a folder that Sequence
    wrote, a folder of bare images: all candidates like any other."""
    (tmp_path / "mine.py").write_text(
        "from optolever.patterns import sequence\n"
        "def good(rows, cols):\n    return sequence('phase', rows, cols)\n"
        "def bad(rows, cols):\n    return 7\n"
        "def dark(rows, cols):\n    import numpy\n    return numpy.zeros((2, rows, cols))\n"
        "def broken(rows, cols):\n    raise ValueError('no')\n"
    )
    monkeypatch.setattr(sys, "path", [part for part in sys.path if part])
    monkeypatch.chdir(tmp_path)
    before = list(sys.path)
    assert user_candidate("mine:good", 40, 60).sequence == sequence("phase", 40, 60)
    assert sys.path == before  # nothing that is imported later comes from there
    for name, complaint in (
        ("bad", "must be a Sequence"),
        ("dark", "returns float64 .2, 40, 60., must be"),
        ("broken", "ValueError: no"),
        ("none", "imported"),
    ):
        with pytest.raises(InputError, match=complaint):
            user_candidate(f"mine:{name}", 40, 60)
    sys.modules.pop("mine")
    shown = sequence("phase", 40, 60, periods=16.0)
    shown.save_png(tmp_path / "described")
    assert user_candidate(str(tmp_path / "described"), 40, 60).sequence == shown
    bare = tmp_path / "bare"
    bare.mkdir()
    lines = []
    for index, frame in enumerate(shown.frames):
        cv2.imwrite(str(bare / f"{index}.png"), shown.render_frame(index))
        lines.append(f'[[frames]]\nfile = "{index}.png"\naxis = "{frame.axis}"\n')
    (bare / "coordinates.toml").write_text("\n".join(lines))
    found = user_candidate(str(bare), 40, 60).sequence
    assert np.array_equal(found.render(), shown.render())
    cv2.imwrite(str(bare / "0.png"), shown.render_frame(0).T.copy()[:40, :40])
    with pytest.raises(InputError, match=r"0\.png: is 40x40 pixels, the pattern has 40x60"):
        user_candidate(str(bare), 40, 60)


def test_slope_limits_of_the_45_degree_prism() -> None:
    """From -atan((L0 - x) / x) / 2, the apex, to 22.5 degrees, along the mirror; free mode h = C x."""
    scene = resize(load("paper-simulation", exact=True), 64, 64)
    maps = sensor_maps(scene)
    on = np.isfinite(maps.low)
    end = scene.pattern.point(scene.pattern.cols - 0.5, 0.0)  # up to a cell beyond the apex
    low = 0.5 * (np.arctan((maps.x - end[0]) / end[2]) - math.radians(45))
    assert maps.low[on] == pytest.approx(low[on], abs=1e-9)
    assert np.degrees(maps.high[on]) == pytest.approx(22.5, abs=1e-6)
    known = np.isfinite(maps.free_mode)
    slope = maps.free_mode[known] / maps.x[known]
    assert np.ptp(slope) < 1e-5 * slope.mean()
    # flat mirror at 45 degrees: path x, and the image folds at a curvature of cos(45 deg) / (2 s)
    assert maps.path[on] == pytest.approx(maps.x[on] / math.sqrt(2), rel=1e-9)
    # a slope turns the ray, which meets the pattern squarely, by twice itself
    lever = 2e-3 * maps.path[on] / scene.pattern.pitch
    assert maps.lever[on] == pytest.approx(lever, rel=1e-6)


PRISM = ["--scene", "prism48", "--pixels", "96x72"]
SMALL = [*PRISM[:-1], "36x48"]


@pytest.mark.slow
def test_design_writes_what_capture_takes(tmp_path: Path) -> None:
    best, numbers = tmp_path / "best.toml", tmp_path / "design.json"
    budget = ["--frames", "12", "--refresh", "60", "--verify", "1"]
    assert run(["design", *PRISM, *budget, "--out", str(best), "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert found["settings"]["frames"] == 12
    assert all(row["frames"] <= 12 for row in found["rows"])
    assert run(["simulate", *PRISM, "--sequence", str(best), "--out", str(tmp_path / "capture")]) == 0
    assert len(list((tmp_path / "capture/frames").glob("*.png"))) == found["rows"][0]["frames"]


def test_range_writes_its_numbers(tmp_path: Path) -> None:
    numbers = tmp_path / "sensor.json"
    assert run(["design", "--range", *SMALL, "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())["numbers"]
    assert found["reflection_margin_deg"] == pytest.approx(48 - math.degrees(math.asin(1 / 1.41)), abs=0.01)


def test_marks_of_the_chart_are_numbered_and_named_below(tmp_path: Path, monkeypatch: Any) -> None:
    """14 codes in each of two conditions; a user's matplotlibrc changes nothing."""
    drawn: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: (drawn.append(self), save(self, *a, **k)))
    rng = np.random.default_rng(5)
    codes = [*(f"phase:steps={n},periods=9/10/11" for n in range(3, 12)), "gray", "gray+phase", "stripe"]
    codes += ["micro-phase", "own.toml@decoders:mine"]
    rows = []
    for code, noise in product(codes, (1.0, 2.0)):
        seconds, cpu, error = np.exp(0.5 * rng.standard_normal(3))
        rows.append(
            Tradeoff(code, noise, 0.0, None, None, None, 24, seconds, cpu, math.nan, 1e-4 * error, 5e-6, 1.0)
        )
    panels, own = condition_panels(rows), {codes[-1]: "A"}
    write_tradeoff_chart(tmp_path / "chart.png", panels, names=own)
    (figure,) = drawn
    with matplotlib.rc_context({"text.usetex": True, "font.size": 30}):
        write_tradeoff_chart(tmp_path / "again.png", panels, names=own)
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "chart.png").read_bytes()
    words = "\n".join(text.get_text() for text in figure.texts[-3:])
    names = dict(line.split(maxsplit=1) for line in words.splitlines())
    assert list(names.values()) == codes
    assert [one for one in names if names[one] == codes[-1]] == ["A"]
    for k, panel in enumerate(figure.axes[:4]):
        at = {names[text.get_text()]: text.xy[0] for text in panel.texts}
        field = ("acquisition_seconds", "cpu_seconds")[k % 2 == 0]
        mine = [row for row in rows if row.condition == rows[k // 2].condition]
        assert at == {row.code: getattr(row, field) for row in mine}
