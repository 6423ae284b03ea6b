"""What fringes do not explain, compiled, against NumPy in float64; and how rough runs of pixels are."""

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode.noise_kernels import LINES, fringe_residuals, pair_residuals
from optolever.decode.sample_kernels import least_rough

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
PIXELS = 900


def shown(steps: int) -> tuple[F64, F64, F64]:
    """Model (N, 3), its inverse and all contrasts that it does not reach."""
    turns = 2 * np.pi * np.arange(steps) / steps
    design = np.stack([np.ones(steps), np.cos(turns), np.sin(turns)], axis=1)
    contrasts = np.linalg.svd(design)[0][:, 3:].T
    return design, np.linalg.pinv(design), contrasts


def seen(steps: int, noise: float, bright: float) -> F32:
    """Levels (2, N, K) of two fringes, some of them faint, some clipped."""
    rng = np.random.default_rng(steps)
    phase = rng.uniform(0, 2 * np.pi, (2, 1, PIXELS))
    share = rng.choice([0.02, 0.3, 1.0, 1.1], (2, 1, PIXELS))
    turns = 2 * np.pi * np.arange(steps)[:, None] / steps
    light = bright * (110 + 80 * share * np.cos(phase - turns)) + rng.normal(0, noise, (2, steps, PIXELS))
    # beside whole levels, as a slope is that of the nearest one: halves between would be a matter of rounding
    return (np.rint(light).clip(0, 255) + 0.23).astype(np.float32)


def expected(own: F64, model: tuple[F64, F64, F64], slope: F64, limit: float) -> tuple[F64, F64]:
    """Level and residuals of one fringe's (N, K) pixels that count."""
    design, inverse, contrasts = model
    fit = inverse @ own
    fitted, residual = design @ fit, contrasts @ own
    if len(slope):
        here = slope[np.rint(fitted).clip(0, len(slope) - 1).astype(int)]
        residual = residual / np.sqrt(contrasts**2 @ (1 / here**2))
    power, whole = fit[1] ** 2 + fit[2] ** 2, own.max(axis=0) < limit
    room = np.minimum(fitted.min(axis=0), limit - fitted.max(axis=0))
    keep = clear(power, whole, room, residual)
    return np.tile(fit[0, keep], len(contrasts)), residual[:, keep].ravel()


def clear(power: F64, whole: NDArray[np.bool_], room: F64, residual: F64) -> NDArray[np.bool_]:
    """Pixels (K,) that see the pattern and stay clear of black and clipping."""
    keep = whole & (power > np.sort(power)[int(0.95 * (PIXELS - 1))] / 16)
    keep = keep if keep.sum() >= 50 else whole
    if keep.any():
        sizes, rooms = np.sort(np.abs(residual[:, keep]).ravel()), np.sort(room[keep])
        rough, least = 1.4826 * sizes[(len(sizes) - 1) // 2], rooms[int(0.65 * (len(rooms) - 1))]
        keep = keep & (room >= min(4 * rough, least) - 1e-4)
    return keep


@pytest.mark.parametrize("limit", [255.0, np.inf])
@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("bright", [0.3, 1.0, 1.6, 9.0])
@pytest.mark.parametrize(("steps", "noise"), [(4, 1.0), (5, 4.0), (8, 1.0), (8, 20.0)])
def test_residuals_of_fringes(steps: int, noise: float, bright: float, curved: bool, limit: float) -> None:
    own, model = seen(steps, noise, bright), shown(steps)
    slope = np.linspace(0.5, 2, 256) if curved else np.zeros(0)
    design, inverse, contrasts = (np.stack([part, part]).astype(np.float32) for part in model)
    count = len(model[2])
    level, residual = np.empty((2, 2 * count * PIXELS), np.float32)
    room, weights = np.empty((LINES, PIXELS), np.float32), np.empty((count, PIXELS), np.float32)
    of_light = slope.astype(np.float32)
    used = fringe_residuals(
        *(own, design, inverse, contrasts, of_light, limit, room, weights, level, residual)
    )
    told = [expected(fringe.astype(np.float64), model, slope, limit) for fringe in own]
    levels, residuals = (np.concatenate(parts) for parts in zip(*told, strict=True))
    assert used == len(levels)
    assert (used == 0) == (bright > 2 and limit == 255)  # nothing but clipped samples
    assert np.allclose(level[:used], levels, atol=2e-3, rtol=1e-5)
    same = np.isclose(residual[:used], residuals, atol=2e-3, rtol=1e-5)
    assert np.count_nonzero(~same) <= (used // 1000 if curved else 0)  # a level halfway has either slope


@pytest.mark.parametrize("limit", [255.0, np.inf])
@pytest.mark.parametrize("bright", [0.3, 1.0, 1.6, 9.0])
@pytest.mark.parametrize(("bits", "noise"), [(2, 1.0), (7, 4.0), (8, 20.0)])
def test_residuals_of_bits_and_inverses(bits: int, noise: float, bright: float, limit: float) -> None:
    rng = np.random.default_rng(bits)
    share = rng.choice([0.02, 0.3, 1.0, 1.1], PIXELS)
    lit = rng.choice([-1.0, -1.0, 0.3, 1.0, 1.0], (bits, PIXELS))  # some of them on edges
    light = bright * (110 + 80 * share * np.stack([lit, -lit])) + rng.normal(0, noise, (2, bits, PIXELS))
    own = np.rint(light).clip(0, 255).astype(np.float32)
    contrasts = np.linalg.svd(np.ones((bits, 1)))[0][:, 1:].T * np.sqrt(0.5)
    count = len(contrasts)
    level, residual = np.empty((2, count * PIXELS), np.float32)
    room, weights = np.empty((LINES, PIXELS), np.float32), np.empty((count, PIXELS), np.float32)
    used = pair_residuals(own.copy(), contrasts.astype(np.float32), limit, room, weights, level, residual)
    wide = own.astype(np.float64)
    middle = wide.mean(axis=(0, 1))
    half = 0.5 * np.sort(np.abs(wide[0] - wide[1]), axis=0)[bits // 2]
    left = contrasts @ wide.sum(axis=0)
    distance = np.minimum(middle - half, limit - middle - half)
    keep = clear(half**2, wide.max(axis=(0, 1)) < limit, distance, left)
    assert used == count * keep.sum()
    assert (used == 0) == (bright > 2 and limit == 255)
    assert np.allclose(level[:used], np.tile(middle[keep], count), atol=2e-3)
    assert np.allclose(residual[:used], left[:, keep].ravel(), atol=2e-3)


@pytest.mark.parametrize("pixels", [1, 2, 3, 8, 120])
def test_roughness_is_that_of_the_smoothest_frame(pixels: int) -> None:
    rng = np.random.default_rng(pixels)
    runs = rng.normal(0, [[[3.0]], [[1.0]], [[9.0]]], (3, 41, pixels)).astype(np.float32)
    told = least_rough(runs, np.empty(41 * pixels, np.float32))
    second = np.sort(np.abs(np.diff(runs.astype(np.float64), 2)).reshape(3, -1), axis=1)
    middle = second[:, (second.shape[1] - 1) // 2].min() if second.size else 0.0
    assert told == pytest.approx(middle, abs=1e-5)
