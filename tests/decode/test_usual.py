"""Usual values that kernels tell, against NumPy: quantiles, steps, contrasts; numbers that threads draw."""

import threading

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode.blur_kernels import digest
from optolever.decode.jit import outer_kernel
from optolever.decode.run_kernels import SOME, changes_down, large_variance
from optolever.decode.sample import sampled
from optolever.decode.select_kernels import least
from optolever.decode.survey_kernels import usual_steps
from optolever.decode.ticket_kernels import draw
from optolever.decode.variance_kernels import variances_by_level

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def middle(values: F64, share: float = 0.5) -> float:
    known = np.sort(values.ravel())
    return float(known[int(share * (len(known) - 1))]) if len(known) else 0.0


@outer_kernel
def chosen(values: F32, count: int, share: float) -> float:
    return least(values, count, share)


@pytest.mark.parametrize("count", [1, 2, 3, 64, 2305])
@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.9, 1.0])
def test_quantiles(count: int, share: float) -> None:
    rng = np.random.default_rng(count)
    values = (10.0 ** rng.uniform(-40, 38, count + 5)).astype(np.float32)  # the least of them are subnormal
    values[::7], values[3::11], values[5::9] = np.inf, 0.0, 0.5
    assert chosen(values, count, share) == np.sort(values[:count])[int(share * (count - 1))]
    assert chosen(values, 0, share) == 0


@outer_kernel
def take(counters: NDArray[np.int64], taken: NDArray[np.int64]) -> None:
    while True:
        number = draw(counters, 1)
        if number >= len(taken):
            return
        taken[number] += 1


def test_every_number_is_drawn_once() -> None:
    counters, taken = np.zeros(3, np.int64), np.zeros(200_000, np.int64)
    take(np.zeros(3, np.int64), np.zeros(1, np.int64))  # compiled
    threads = [threading.Thread(target=take, args=(counters, taken)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert np.all(taken == 1)
    assert counters.tolist() == [0, len(taken) + 4, 0]


@pytest.fixture(name="lines")
def given_lines() -> F64:
    """(12, 300): steep along rows, with steps that are not known."""
    rng = np.random.default_rng(2)
    lines = 1.3 * np.arange(300.0) + 0.2 * np.arange(12.0)[:, None] + 0.1 * rng.standard_normal((12, 300))
    lines[3, 40:90] = np.nan
    return lines


def test_steps_of_a_survey(lines: F64) -> None:
    below = lines + np.random.default_rng(3).uniform(0.5, 0.9, lines.shape)
    sigma = np.random.default_rng(4).uniform(0.1, 0.2, lines.shape).astype(np.float32)
    usual, room = np.empty(5), np.empty((3, lines.size), np.float32)
    usual_steps(lines, below, sigma, 2.0, 3, 4, room, usual)
    along, down = np.abs(np.diff(lines))[:, ::3], np.abs(below - lines)[:, ::3] / 2
    at = np.arange(0, 298, 4)
    bend = np.abs(lines[:, at] - 2 * lines[:, at + 1] + lines[:, at + 2])
    gradient = 0.5 * np.abs(lines[:, at + 2] - lines[:, at])
    known = [along[along < np.inf], down[down < np.inf], bend, gradient, sigma[:, at].astype(np.float64)]
    np.testing.assert_allclose(usual, [middle(values) for values in known], rtol=1e-6)


@pytest.mark.parametrize("down", [False, True])
def test_gradients_of_a_map(lines: F64, down: bool) -> None:
    chart = np.ascontiguousarray(lines.T if down else lines)
    flat, cols, room = chart.reshape(-1), chart.shape[1], np.empty(SOME, np.float32)
    assert changes_down(flat, cols, room) == down
    table = np.linspace(0, 2, 200) ** 2
    steps = []
    for line in lines:
        for x in range(0, 300, 2):  # every other pixel of all lines, at this size
            far = [y for y in (max(x - 8, 0), min(x + 8, 299)) if abs(y - x) > 4]
            sizes = [abs(line[y] - line[x]) / abs(y - x) for y in far]
            steps.append(min((size for size in sizes if size < np.inf), default=0.0))
    want = middle(table[np.minimum(np.array(steps) * 50, 199).astype(int)], 0.9)
    got = large_variance(flat, cols, down, 8, table, 50.0, 0.9, room)
    assert got == pytest.approx(want, rel=1e-6)


def test_contrasts_in_few_numbers() -> None:
    rng = np.random.default_rng(5)
    seen = np.stack([rng.normal(0.8, 0.02, 500), rng.uniform(0, 900, 500), *rng.uniform(0.5, 1.5, (2, 500))])
    seen[0, ::50] = 3.0
    usual, room = np.empty(6), np.empty((2, 500), np.float32)
    used = digest(seen, room, usual)
    low, half, high = (middle(seen[0], share) for share in (0.25, 0.5, 0.75))
    near = np.abs(seen[0] - 0.5 * (low + high)) <= 3 * (high - low) + 1e-3
    want = [middle(seen[2]), middle(seen[3]), low, half, high, seen[0, near].mean()]
    np.testing.assert_allclose(usual, want, rtol=1e-6)
    assert used == near.sum() < 495
    np.testing.assert_allclose(room[0, :used], seen[0, near], rtol=1e-6)
    np.testing.assert_allclose(room[1, :used], (seen[1] - np.rint(seen[1]))[near], atol=1e-6)


@pytest.mark.parametrize("groups", [1, 3])
def test_outliers_do_not_move_a_variance(groups: int) -> None:
    """Residuals of three levels, in any order: none, some outliers among those of 4, and these alone."""
    rng = np.random.default_rng(7)
    residual = np.stack([np.zeros(4000), *rng.normal(0, 2.0, (2, 4000))]).astype(np.float32)
    residual[1, ::10] = 90.0
    level = np.repeat(np.float32([3, 70, 200]), 4000) + rng.uniform(-5, 5, 12000).astype(np.float32)
    order, dither = rng.permutation(12000), rng.uniform(-1, 1, 12000).astype(np.float32)
    mean, found = np.empty((2, groups))
    room, counts = np.empty((3, 12000), np.float32), np.empty(4096, np.int64)
    variances_by_level(level[order], residual.ravel()[order], dither, room, counts, mean, found)
    for k, own in enumerate(residual.astype(np.float64).reshape(groups, -1)):
        variance = (1.4826 * middle(np.abs(own)) + 0.5) ** 2
        for _ in range(3):
            variance = np.mean(own[own**2 < 16 * variance] ** 2) if variance > 0 else 0.0
        assert found[k] == pytest.approx(variance, rel=1e-5)
        assert mean[k] == pytest.approx(level.reshape(groups, -1)[k].mean(dtype=np.float64), rel=1e-5)
    assert groups == 1 or found[1:] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_samples_are_runs_of_pixels(kind: type) -> None:
    frames = np.random.default_rng(6).integers(0, 250, (3, 130, 211)).astype(kind)
    found = sampled(frames)
    starts = np.arange(0, 204, 203 // 15)
    assert found.rows.tolist() == list(range(0, 130, 2))
    want = np.stack([frames[:, ::2, start : start + 8] for start in starts], axis=2)
    np.testing.assert_array_equal(found.runs, want)
