"""A concave facet of 300 mm, R = 4 m, a bump of 3 um and waviness, from rendered frames to its figures."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from optolever.cli import run
from optolever.decode import decode
from optolever.metrology import fit_zernike
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.reconstruct import HeightMap, reconstruct, slope_map
from optolever.scene import Scene, Surface, load, resize

Floats = NDArray[np.float64]
RADIUS, MIDDLE = 4000.0, 150.0
RIG = """\
exact = true
[mirror]
size_mm = [300, 300]
[pattern]
size = [1920, 1080]
pitch_mm = 0.4
blur_px = 0.5
origin_mm = [49.2, -233.8, 1511.977]
u_axis = [0, 1, 0]
v_axis = [-0.9781476, 0, -0.2079117]
[camera]
kind = "pinhole"
size = [320, 240]
focal_mm = 50
pixel_pitch_mm = 0.0344
position_mm = [565.8234, 150, 1956.295]
look_at_mm = [150, 150, 0]
"""


def form(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Height and slopes: sphere, bump, waves of 60 mm."""
    u, v, k = x - MIDDLE, y - MIDDLE, 2 * np.pi / 60
    root = np.sqrt(np.maximum(1 - (u * u + v * v) / RADIUS**2, 1e-9))
    bump = 3e-3 * np.exp(-((u - 30) ** 2 + (v + 20) ** 2) / 1250)
    wave = 5e-4 * k
    return (
        (u * u + v * v) / RADIUS / (1 + root) + bump + 5e-4 * np.sin(k * u) * np.sin(k * v),
        u / RADIUS / root - bump * (u - 30) / 625 + wave * np.cos(k * u) * np.sin(k * v),
        v / RADIUS / root - bump * (v + 20) / 625 + wave * np.sin(k * u) * np.cos(k * v),
    )


FACET = Surface(lambda x, y: form(x, y)[0], lambda x, y: form(x, y)[1:])


def rig(folder: Path, rows: int, cols: int) -> Scene:
    (folder / "rig.toml").write_text(RIG)
    return resize(load(folder / "rig.toml"), rows, cols)


def measured(scene: Scene, seed: int) -> tuple[HeightMap, Any]:
    """Height map and slopes from frames with a grey level of noise."""
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    frames = capture(scene, FACET, shown, noise=1.0, seed=seed, renderer="numpy").frames
    seen = decode(frames, shown)
    top = float(form(np.array(MIDDLE), np.array(MIDDLE))[0])
    height = reconstruct(seen, scene, anchor=(MIDDLE, MIDDLE, top))
    return height, slope_map(height, seen, scene)


def test_residual_and_radius_of_the_facet(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Against the form's exact heights, whose best sphere is linear algebra, as bump and waves are small."""
    height, slopes = measured(rig(tmp_path, 240, 320), seed=1)
    height.save(tmp_path / "h.npz")
    slopes.save(tmp_path / "s.npz")
    names = ["form", "h.npz", "--slopes", "s.npz", "--json", "f.json", "--out", "r.npz", "--zernike", "3"]
    assert run([str(tmp_path / name) if "." in name else name for name in names]) == 0
    found = json.loads((tmp_path / "f.json").read_text())
    inner = binary_erosion(height.good, np.ones((3, 3)))  # without the outermost ring
    x, y = (part[inner] for part in (height.x, height.y))
    r2 = (x - MIDDLE) ** 2 + (y - MIDDLE) ** 2
    rest = form(x, y)[0] - r2 / RADIUS / (1 + np.sqrt(1 - r2 / RADIUS**2))
    terms = np.stack([np.ones_like(x), x - MIDDLE, y - MIDDLE, r2], axis=1)
    best = np.linalg.lstsq(terms, rest, rcond=None)[0]
    rms, radius = (rest - terms @ best).std(), 1 / (1 / RADIUS + 2 * best[3])
    assert found["rms_mm"] == pytest.approx(rms, rel=0.01)
    assert found["numbers"]["radius"]["value"] == pytest.approx(radius, rel=1e-4)
    assert abs(found["numbers"]["radius"]["value"] - radius) < 5 * found["numbers"]["radius"]["sigma"]
    assert np.nanstd(HeightMap.load(tmp_path / "r.npz").z) == pytest.approx(found["rms_mm"], rel=1e-6)
    assert found["rms_less_noise_mm"] < found["rms_mm"]
    printed = capfd.readouterr().out
    assert "µrad rms along x" in printed
    said = re.search(r"heights (\S+) µm rms ± .*?; without its noise (\S+)", " ".join(printed.split()))
    assert said
    raw, less = said.groups()
    assert float(raw) == pytest.approx(1e3 * rms, rel=0.01)
    assert 0 <= float(raw) - float(less) < 0.01 * float(raw)
    assert run(["form", str(tmp_path / "h.npz"), "--remove", "sphere:radius=4"]) == 0  # m, not mm
    assert "sphere:radius=4: leaves" in capfd.readouterr().err


@pytest.mark.slow
def test_sigmas_of_coefficients_hold_over_seeds(tmp_path: Path) -> None:
    """chi2 of Zernike coefficients up to order 3 per degree of freedom, over 30 seeds."""
    scene, chi2 = rig(tmp_path, 60, 80), []
    for seed in range(30):
        height, slopes = measured(scene, seed)
        fit = fit_zernike(height, 3, slopes)
        exact = HeightMap(height.x, height.y, form(height.x, height.y)[0], height.sigma, height.flags)
        true = fit_zernike(exact, 3, radius=fit.radius)
        chi2.append(((fit.numbers.values - true.numbers.values)[1:] / fit.numbers.sigma[1:]) ** 2)
    assert 0.75 < float(np.mean(chi2)) < 1.3
