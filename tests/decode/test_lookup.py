"""Look-up in known levels: free grey values, stripes, codes within their cells, spots; from closed forms."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode.estimate import Estimate
from optolever.decode.frames import Light, light_of
from optolever.decode.lookup import Table, lookup_rows, prepare
from optolever.decode.noise import Noise, Sample, sampled
from optolever.decode.plan import plan
from optolever.decode.spot_scan import raster_axes
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence, sequence

from .light import seen_by_pixels

F64 = NDArray[np.float64]
Shoot = Callable[..., NDArray[Any]]


@dataclass(frozen=True)
class Case:
    shown: Sequence
    light: Light
    noise: Noise
    table: Table

    def decoded(self, cuts: tuple[int, ...] = (), cells: F64 | None = None) -> Estimate:
        """All rows, in blocks that end at the cuts."""
        height, width = self.light.raw.shape[1:]
        found = Estimate.empty(height, width, self.table.freedom)
        if cells is not None:
            found.coordinate[:], found.variance[:] = cells, self.table.cell**2 / 12
        for start, stop in zip((0, *cuts), (*cuts, height), strict=True):
            part = Estimate(*(array[start:stop] for array in found.arrays()), found.freedom)
            lookup_rows(self.light, self.noise, self.table, (start, stop), part)
        return found


def case(
    shown: Sequence, frames: NDArray[Any], noise: float, axis: int = 0, gain: float = 0.0, **more: Any
) -> Case:
    light = light_of(frames, shown)
    known, wanted = Noise(noise**2 + 1 / 12, gain), plan(shown)
    lit = sampled(light, None, 256)
    keep = np.ptp(lit.levels, axis=0) > 12 * noise
    cells = more.pop("cells", None)
    lit = Sample(lit.places[keep], lit.levels[:, keep])
    if cells is not None:
        cells = cells[lit.places[:, 0], lit.places[:, 1]]
    own = (raster_axes(shown) or wanted.axes)[axis]
    return Case(shown, light, known, prepare(shown, wanted, own, light, known, lit, cells))


def free(cols: int, frames: int, seed: int = 0) -> Sequence:
    values = np.random.default_rng(seed).integers(0, 256, (frames, cols))
    return Sequence(tuple(Frame("levels", "u", levels=tuple(row.tolist())) for row in values), 4, cols)


def places(cols: int, width: float, rows: int = 40) -> F64:
    return 6 + 0.97 * width * np.arange(int((cols - 14) / width)) + 0.0273 * np.arange(rows)[:, None]


def seen(
    shown: Sequence, u: F64, width: float, blur: float, noise: float, scale: float = 1.0
) -> NDArray[np.uint8]:
    light = np.concatenate([seen_by_pixels(shown, row, width, blur) for row in u], axis=1) * scale
    noisy = light + noise * np.random.default_rng(7).standard_normal(light.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def scores(found: Estimate, truth: F64) -> F64:
    """Errors over sigma of the pixels that are said to be right."""
    good = np.isfinite(found.coordinate) & (found.error < 1e-4)
    return np.asarray(((found.coordinate - truth) / np.sqrt(found.variance))[good], np.float64)


@pytest.mark.parametrize(
    ("width", "blur", "noise"), [(1.0, 0.02, 1.0), (0.6, 0.02, 2.0), (1.0, 0.5, 1.0), (2.0, 0.3, 1.0)]
)
def test_free_levels(width: float, blur: float, noise: float) -> None:
    shown, u = free(200, 12), places(200, width)
    found = case(shown, seen(shown, u, width, blur, noise), noise).decoded()
    score = scores(found, u)
    assert score.size > 0.97 * u.size
    assert np.mean(np.abs(score) > 5) <= 2e-4
    assert 0.3 < np.sqrt(np.mean(score**2)) < 1.25
    assert np.median(found.amplitude) == pytest.approx(0.85 * 127.5, rel=0.1)
    assert np.median(found.offset) == pytest.approx(16 + 0.85 * 127.5, rel=0.1)


def test_levels_that_jump_and_dark_rows() -> None:
    shown = free(300, 10)
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(8, 290, (30, 8)), 20, axis=1) + 0.3 * np.tile(np.arange(20), 8)
    frames = seen(shown, u, 1.0, 0.3, 1.0)
    frames[:, 10:14] = np.clip(np.rint(20 + rng.standard_normal(frames[:, 10:14].shape)), 0, 255)
    frames[:, 20:24] = 255
    lit = np.ones(30, bool)
    lit[10:14] = lit[20:24] = False
    found = case(shown, frames, 1.0).decoded()
    good = np.isfinite(found.coordinate) & (found.error < 1e-4)
    assert not good[~lit].any()
    assert good[lit].mean() > 0.98
    assert np.abs((found.coordinate - u)[good]).max() < 0.5


def test_blocks_do_not_matter() -> None:
    shown, u = free(200, 10), places(200, 1.0)
    one = case(shown, seen(shown, u, 1.0, 0.3, 1.0), 1.0)
    for whole, parts in zip(one.decoded().arrays(), one.decoded((3, 16, 17)).arrays(), strict=True):
        np.testing.assert_array_equal(whole, parts)


def test_saturated_samples_are_left_out() -> None:
    shown, u = free(200, 14), places(200, 1.0)
    frames = seen(shown, u, 1.0, 0.3, 1.0)
    frames[np.random.default_rng(1).random(frames.shape) < 0.05] = 255
    found = case(shown, frames, 1.0).decoded()
    assert 0.2 < (found.clipped > 0).mean() < 0.9
    assert scores(found, u).size > 0.95 * u.size
    good = np.isfinite(found.coordinate) & (found.error < 1e-4)
    assert np.abs((found.coordinate - u)[good]).max() < 0.5


def test_two_places_alike_are_known() -> None:
    """Every level is shown at two places: an even chance."""
    values = np.tile(np.random.default_rng(5).integers(0, 256, (8, 60)), 2)
    shown = Sequence(tuple(Frame("levels", "u", levels=tuple(row.tolist())) for row in values), 4, 120)
    u = 5 + 0.9 * np.arange(50) + 0.013 * np.arange(20)[:, None]
    found = case(shown, seen(shown, u, 1.0, 0.3, 1.0), 1.0).decoded()
    assert np.median(found.error) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("params", [{"step": 4}, {"step": 8, "width": 16}, {"step": 3, "width": 9}])
def test_swept_stripe(shoot: Shoot, smooth: tuple[F64, F64], params: dict[str, float]) -> None:
    shown = sequence("stripe", 150, 170, **params)
    frames = shoot(shown, *smooth, noise=1.0)
    for axis, truth in enumerate(smooth):
        found = case(shown, frames, 1.0, axis).decoded()
        score = scores(found, truth)
        assert score.size > 0.999 * truth.size
        assert np.sqrt(np.mean(score**2)) == pytest.approx(1, abs=0.04)
        assert np.abs(found.coordinate - truth).max() < 0.03 * params["step"]


def test_swept_stripe_in_shot_noise(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("stripe", 150, 170, step=4)
    found = case(shown, shoot(shown, *smooth, noise=0.5, gain=0.3), 0.5, gain=0.3).decoded()
    assert np.sqrt(np.mean(scores(found, smooth[0]) ** 2)) == pytest.approx(1, abs=0.05)


def test_second_bright_stripe_and_darkness() -> None:
    shown = sequence("stripe", 4, 170, axes="u", step=4)
    u = places(170, 1.0)[:, :100]
    frames = seen(shown, u, 1.0, 0.3, 1.0)
    ghost = np.rint(0.5 * frames + 0.5 * seen(shown, u + 40, 1.0, 0.3, 1.0)).astype(np.uint8)
    ghost[:, :10] = np.clip(
        np.rint(20 + np.random.default_rng(0).standard_normal(ghost[:, :10].shape)), 0, 255
    )
    found = case(shown, ghost, 1.0).decoded()
    assert (found.error[10:] > 0.1).all()
    assert np.mean(np.isnan(found.coordinate[:10]) | (found.error[:10] > 1e-4)) == 1


@pytest.mark.parametrize(("width", "blur"), [(1.0, 0.5), (0.6, 0.02), (1.0, 0.2)])
def test_gray_within_its_cells(width: float, blur: float) -> None:
    shown, u = sequence("gray", 4, 150, axes="u"), places(150, width)
    cells = np.rint(u)
    one = case(shown, seen(shown, u, width, blur, 1.0), 1.0, cells=cells)
    found = one.decoded(cells=cells)
    score = (found.coordinate - u) / np.sqrt(found.variance)
    assert np.sqrt(np.mean(score**2)) < 1.25
    assert np.mean(np.abs(score) > 5) <= 2e-4
    assert np.sqrt(np.mean((found.coordinate - u) ** 2)) < (1.1 * 0.4 / 12**0.5 if width < 1 else 0.05)


def test_spots_are_two_sweeps() -> None:
    shown = sequence("spot", 66, 78)
    row, col = np.mgrid[:40, :50].astype(np.float64)
    u, v = 3 + 1.27 * col + 3 * np.sin(row / 21), 4 + 1.3 * row + 3 * np.cos(col / 17)

    def profile(coord: F64, at: float | None, width: float | None) -> F64:
        distance = np.abs(coord - (at or 0.0)) / (width or 1.0)
        return np.where(distance < 1, 0.5 + 0.5 * np.cos(np.pi * distance), 0.0)

    rng = np.random.default_rng(0)
    frames = np.array(
        [12 + 190 * profile(u, f.at_u, f.width_px) * profile(v, f.at_v, f.width_px) for f in shown.frames]
    )
    frames = np.clip(np.rint(frames + 3 * rng.standard_normal(frames.shape)), 0, 255).astype(np.uint8)
    for axis, truth in enumerate((u, v)):
        found = case(shown, frames, 3.0, axis).decoded()
        score = scores(found, truth)
        assert score.size > 0.99 * truth.size
        assert np.sqrt(np.mean(score**2)) == pytest.approx(1, abs=0.06)
        assert np.median(found.amplitude) == pytest.approx(95, rel=0.1)
        assert np.median(found.offset - found.amplitude) == pytest.approx(12, abs=3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda frames: frames[:-1], "every place once"),
        (lambda frames: (*frames, Frame("gray", "u", bit=0)), "spots stand alone"),
        (lambda frames: (*frames, Frame("white", exposure=2.0)), "exposure is 2"),
        (lambda frames: (*frames, Frame("stripe", "uv", width_px=2.0, at_u=0.0, at_v=0.0)), "must be alike"),
    ],
)
def test_bad_rasters(change: Callable[[tuple[Frame, ...]], tuple[Frame, ...]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        raster_axes(Sequence(change(sequence("spot", 40, 60).frames), 40, 60))
