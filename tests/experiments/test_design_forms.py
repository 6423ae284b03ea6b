"""Closed forms of the design against brute force: integration, Monte Carlo, formulas of their own."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erfc, ndtr

from optolever.decode import BorderTable, border_table
from optolever.errors import InputError
from optolever.experiments.design import view_of
from optolever.experiments.design.border import _seen, border_factor, border_of, usual_width
from optolever.experiments.design.border_draws import drawn_at_border
from optolever.experiments.design.cells import stairs, stairs_of_noise
from optolever.experiments.design.codes import cell_error, misread
from optolever.experiments.design.free_codes import PER_CELL, seen_profiles
from optolever.experiments.design.fringes import (
    combined,
    contrast,
    grouped,
    search_failure,
    step_failure,
    turn_variance,
)
from optolever.experiments.design.records import AxisPrediction, Steps
from optolever.patterns import Frame, Sequence, sequence
from optolever.scene import dent, load, resize


def fringe(period: float, steps: int) -> list[Frame]:
    return [Frame("phase", "u", period_px=period, shift=2 * math.pi * k / steps) for k in range(steps)]


@pytest.mark.parametrize("steps", [3, 4, 7])
def test_phase_noise_is_the_cramer_rao_bound(steps: int) -> None:
    """sigma_phi = sqrt(2/N) sigma/B, and Monte Carlo agrees."""
    amplitude, noise = 60.0, 2.0
    (group,) = grouped(fringe(8.0, steps))
    variance, share = turn_variance(group, np.array(amplitude), np.array(100.0), noise**2, 0.0)
    assert share == pytest.approx(2 / steps)
    assert math.sqrt(variance) == pytest.approx(math.sqrt(2 / steps) * noise / amplitude / (2 * math.pi))
    rng = np.random.default_rng(0)
    phase = rng.uniform(-math.pi, math.pi, 40000)
    samples = (
        100 + amplitude * np.cos(phase[:, None] - group.shifts) + noise * rng.normal(size=(40000, steps))
    )
    _, c, s = group.solve() @ samples.T
    error = np.angle(np.exp(1j * (np.arctan2(s, c) - phase))) / (2 * math.pi)
    assert error.std() == pytest.approx(math.sqrt(variance), rel=0.02)


def test_shot_noise_of_three_steps_against_monte_carlo() -> None:
    """Variance in proportion to the level, averaged over the phase."""
    amplitude, mean, shot = 40.0, 100.0, 0.5
    (group,) = grouped(fringe(8.0, 3))
    variance, _ = turn_variance(group, np.array(amplitude), np.array(mean), 0.25, shot)
    rng = np.random.default_rng(1)
    phase = rng.uniform(-math.pi, math.pi, 60000)
    level = mean + amplitude * np.cos(phase[:, None] - group.shifts)
    samples = level + np.sqrt(0.25 + shot * level) * rng.normal(size=level.shape)
    _, c, s = group.solve() @ samples.T
    error = np.angle(np.exp(1j * (np.arctan2(s, c) - phase))) / (2 * math.pi)
    assert error.std() == pytest.approx(math.sqrt(variance), rel=0.02)


def light_at(place: float, period: float, widths: tuple[float, float], blur: float) -> complex:
    """Complex fringe on cells through two boxes and a Gaussian, cell by cell."""
    cells = np.arange(round(place) - 12, round(place) + 13)
    first, second = np.meshgrid(*((np.arange(128) + 0.5) / 128 - 0.5,) * 2)
    shift = (first * widths[0] + second * widths[1]).ravel()[:, None]
    edges = np.append(cells - 0.5, cells[-1] + 0.5) - place
    share = np.diff(ndtr((edges - shift) / blur), axis=1).mean(axis=0)
    return complex((share * np.exp(2j * np.pi * cells / period)).sum())


@pytest.mark.parametrize("period", [4.0, 6.5, 16.0])
def test_contrast_and_stairs_against_integration(period: float) -> None:
    """What is left of a fringe's contrast, and where the cells shift it."""
    widths, blur = (0.7, 0.3), 0.35
    boxes = (np.array(widths[0]), np.array(widths[1]))
    places = 10 + np.arange(40) * 13 / 40
    seen = np.array([light_at(place, period, widths, blur) for place in places])
    error = np.angle(seen * np.exp(-2j * np.pi * places / period)) * period / (2 * np.pi)
    assert stairs(places, boxes, blur, period) == pytest.approx(error, abs=2e-4)
    share, slope = stairs_of_noise(places, boxes, blur, period)
    fundamental = np.abs(np.mean(seen * np.exp(-2j * np.pi * places / period)))
    assert contrast(period, boxes, blur) == pytest.approx(fundamental, rel=1e-3)
    assert share == pytest.approx(np.abs(seen) / fundamental, abs=2e-3)
    beside = [stairs(places + step, boxes, blur, period) for step in (-1e-4, 1e-4)]
    assert slope == pytest.approx((beside[1] - beside[0]) / 2e-4, abs=1e-5)


def test_stairs_of_a_long_period_are_the_sawtooth() -> None:
    """Nearest cell: rms (1 - w) / sqrt 12 for w = 0."""
    places = 100 + (np.arange(1000) + 0.5) / 1000
    error = stairs(places, (np.array(0.0), np.array(0.0)), 0.0, 1e4)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(
        1 / math.sqrt(12), rel=0.15
    )  # nine terms of the series


@pytest.mark.parametrize("distance", [-0.2, 0.3, 1.0])
def test_border_against_integration(distance: float) -> None:
    """Cells from 0 on, dark before them."""
    period, spread = 8.0, 0.6
    place = (np.arange(200000) + 0.5) / 200000 * 16 - 8
    weight = np.exp(-0.5 * (place / spread) ** 2)
    weight /= weight.sum()
    cells = np.rint(place + distance - 0.5)
    shown = np.exp(2j * np.pi * (cells - distance + 0.5) / period)
    whole = np.sinc(1 / period) * (weight * np.exp(2j * np.pi * place / period)).sum()
    rest = whole - (weight * shown)[cells < 0].sum()
    kept = border_factor(np.array(distance), spread, period)
    assert abs(kept) == pytest.approx(abs(rest / whole), abs=1e-4)
    assert np.angle(kept) == pytest.approx(np.angle(rest / whole), abs=1e-4)


@pytest.mark.parametrize("count", [9, 17])
def test_order_errors_of_two_periods(count: int) -> None:
    """erfc(pi / (sqrt 2 sigma_phi sqrt(v1^2 + v2^2))) for |v1 - v2| = 1."""
    extent, sigma_phi = 360.0, 0.8 / count
    periods = [extent / count, extent / (count + 1)]
    variances = [np.array((period * sigma_phi / (2 * math.pi)) ** 2) for period in periods]
    expected = erfc(math.pi / (math.sqrt(2) * sigma_phi * math.hypot(count, count + 1)))
    failure, flagged = search_failure(periods, variances, extent)
    # the wrong orders lie v fringes away; on a finite surface they are there for most places only
    assert 0.4 * expected < failure < 1.1 * expected
    assert flagged > failure


def test_order_errors_of_a_ladder_against_monte_carlo() -> None:
    period, deviation = 8.0, 2.2
    rng = np.random.default_rng(2)
    wrong = np.rint(rng.normal(0, deviation, 200000) / period) != 0
    assert step_failure(period, np.array(deviation**2)) == pytest.approx(wrong.mean(), rel=0.03)


def test_combination_adds_information_unless_much_coarser() -> None:
    one, two = np.array(4.0), np.array(1.0)
    assert combined([9.0, 8.0], [one, two]) == pytest.approx(0.8)
    assert combined([90.0, 8.0], [one, two]) == pytest.approx(1.0)


def test_cell_error_is_uniform() -> None:
    coord = np.linspace(0, 64, 100001)
    error = cell_error(coord, Frame("gray", "u", bit=0, cell_px=4.0))
    assert np.abs(error).max() <= 2.0
    assert error.std() == pytest.approx(4 / math.sqrt(12), rel=1e-3)


def test_misread_gray_bits_against_monte_carlo() -> None:
    """Bits of blurred Gray frames, read against white and black: how often the cell is no neighbour."""
    cells, half, noise, blur = 64, 30.0, 10.0, 0.4
    frames = [Frame("gray", "u", bit=bit) for bit in range(6)]
    rng = np.random.default_rng(3)
    place = rng.uniform(8, 56, 40000)
    nothing = (np.full(place.shape, 1e-3),) * 2
    predicted = misread(
        frames, True, place, np.full(place.shape, half), np.full(place.shape, noise), nothing, blur, cells
    )
    word = np.zeros(place.shape, int)
    threshold = half + 0.5 * noise * (rng.normal(size=place.shape) + rng.normal(size=place.shape))
    for frame in frames:
        table = frame.tables(1, cells)[0] / 255.0
        edges = np.flatnonzero(np.diff(table)) + 0.5
        level = np.full(place.shape, table[0])
        for edge in edges:
            level += (
                (table[int(edge + 0.5)] - table[int(edge - 0.5)])
                * 0.5
                * erfc((edge - place) / (math.sqrt(2) * blur))
            )
        read = 2 * half * level + noise * rng.normal(size=place.shape)
        word |= (read > threshold).astype(int) << (frame.bit or 0)
    cell = word.copy()
    for shift in (1, 2, 4):
        cell ^= cell >> shift
    far = np.abs(cell - np.rint(place)) > 1
    assert predicted.mean() == pytest.approx(far.mean(), rel=0.25)


def test_a_code_that_noise_dithers_is_drawn_as_it_is_read() -> None:
    """Steps to a neighbour, up more often than down: mean 0, and the deviation of what is drawn."""
    rng = np.random.default_rng(4)
    up, down, pitch = np.array([0.3, 0.02]), np.array([0.1, 0.0]), 2.0
    there = AxisPrediction(*(np.zeros(2),) * 5, steps=Steps(up, down, pitch, np.ones(2)))
    units = rng.normal(size=(20000, 2))
    drawn = np.stack([there.drawn(unit) for unit in units])
    stated = np.stack([there.stated_for(unit) for unit in units])
    stays = -pitch * (0.3 - 0.1)
    assert (stated[:, 0] == np.where(np.isclose(drawn[:, 0], stays), 0.0, 1.0)).all()
    step = rng.choice([1, -1, 0], size=(20000,), p=[0.3, 0.1, 0.6])
    assert drawn.mean(axis=0) == pytest.approx(0.0, abs=0.03)
    assert drawn.std(axis=0)[0] == pytest.approx(pitch * step.std(), rel=0.03)
    assert drawn.std(axis=0)[1] == pytest.approx(pitch * math.sqrt(0.02 * 0.98), rel=0.06)


def test_periods_that_the_border_shifts_apart_are_refused() -> None:
    """chi squared of the periods' disagreement beyond what noise makes once in five sigmas."""
    rng = np.random.default_rng(5)
    groups, variances = grouped(fringe(16.0, 4) + fringe(8.0, 4)), [np.array([0.02]), np.array([0.01])]
    limit = (1 - 2 / 9 + 5 * math.sqrt(2 / 9)) ** 3
    for apart in (0.0, 0.9, 1.1):
        shifts = [np.array([2 * math.pi * apart / 16]), np.array([0.0])]
        _, refused = _seen(groups, shifts, variances)
        chi2 = (apart + math.sqrt(0.03) * rng.normal(size=20000)) ** 2 / 0.03
        assert refused[0] == pytest.approx((chi2 > limit).mean(), abs=0.03)


def test_pixels_beside_refused_ones_are_those_that_noise_left_there() -> None:
    """Mean of what is read where noise decides whether it is refused: Monte Carlo of a pixel at the edge."""
    scene = resize(load("paper-simulation"), 64, 64)
    scene = replace(scene, pattern=replace(scene.pattern, blur_px=2.0))
    view = view_of(scene, dent("flat", scene))
    shown = sequence("phase", scene.pattern.rows, scene.pattern.cols, steps=4, periods=16.0)
    groups = grouped([frame for frame in shown.frames if frame.axis == "u"])
    still = [np.full(view.visible.shape, 1e-8)]
    sigma = np.full(view.visible.shape, 0.3)
    quiet = border_of(view, "u", shown, groups, still, np.full(view.visible.shape, 1e-6), 2.0)
    told = border_of(view, "u", shown, groups, [sigma**2], sigma, 2.0)
    partly = (told.refused > 0.05) & (told.refused < 0.9)
    assert partly.any()
    table = border_table(shown, "u", usual_width(view, "u"), 2.0)
    read = view.coordinate("u")
    for _ in range(30):
        read = view.coordinate("u") + quiet.left + np.interp(read, table.at, table.shift)
    rng = np.random.default_rng(6)
    for row, col in np.argwhere(partly)[:4]:
        drawn = read[row, col] + 0.3 * rng.standard_normal(400000)
        entry = np.floor((drawn - table.at[0]) / (table.at[1] - table.at[0])).astype(int)
        kept = ~table.refused[np.clip(entry, 0, len(table.at) - 1)]
        error = (drawn - view.coordinate("u")[row, col] - np.interp(drawn, table.at, table.shift))[kept]
        assert told.refused[row, col] == pytest.approx(1 - kept.mean(), abs=0.06)
        assert told.left[row, col] == pytest.approx(error.mean(), abs=0.1 * error.std() + 0.02)
        assert told.gain[row, col] * 0.3 == pytest.approx(error.std(), rel=0.15)


def test_noise_that_makes_periods_agree_is_not_like_other_noise() -> None:
    """Two periods, the finer one 1.2 cells off: brute force of those that are left."""
    groups, table = (
        grouped(fringe(16.0, 4) + fringe(8.0, 4)),
        BorderTable(np.arange(-8.0, 80.0, 0.125), np.zeros(704), np.zeros(704, bool), np.zeros(704, bool)),
    )
    variances, limit = (0.04, 0.02), 12.0
    told = drawn_at_border(
        groups,
        [np.zeros(64), np.full(64, 1.2)],
        [np.full(64, variance) for variance in variances],
        np.full(64, 30.0),
        table,
        *(64, 0.5, limit),
    )
    rng = np.random.default_rng(8)
    coarse, fine = (np.sqrt(variance) * rng.standard_normal(400000) for variance in variances)
    left = (1.2 + fine - coarse) ** 2 / sum(variances) <= limit
    both = ((coarse / variances[0] + (1.2 + fine) / variances[1]) / sum(1 / v for v in variances))[left]
    assert told.refused.mean() == pytest.approx(1 - left.mean(), abs=0.01)
    assert told.mean.mean() == pytest.approx(both.mean(), abs=0.01)
    assert np.mean(told.deviation) == pytest.approx(both.std(), rel=0.05)


def test_any_pattern_has_the_bound_of_a_fringe() -> None:
    """Fisher information of the tables of a fringe gives sqrt(2/N) sigma/B P / (2 pi)."""
    steps, period = 5, 16.0
    shown = sequence("phase", 64, 256, steps=steps, periods=period, axes="u")
    seen = seen_profiles(shown, "u", 0.5, 0.5)
    slope = np.gradient(seen, 0.25, axis=1)[:, 200:-200]
    information = (slope**2).sum(axis=0).mean()
    widths = (np.array(0.5), np.array(0.0))
    bound = math.sqrt(2 / steps) / (0.5 * contrast(period, widths, 0.5)) * period / (2 * math.pi)
    assert 1 / math.sqrt(information) == pytest.approx(bound, rel=0.03)


@pytest.mark.parametrize("width", [0.3, 1.0, 2.0, 2.6])
def test_seen_profiles_lie_where_the_stripe_is(width: float) -> None:
    """Their middle, and the variance that blur and pixel add to a cell's."""
    frame = Frame("stripe", "u", at_u=20.0, width_px=1.0)
    seen = seen_profiles(Sequence((frame,), 4, 40), "u", width, 0.7)[0]
    place = (np.arange(len(seen)) + 0.5) / PER_CELL - 0.5
    middle = float(np.sum(place * seen) / np.sum(seen))
    variance = float(np.sum((place - middle) ** 2 * seen) / np.sum(seen))
    assert middle == pytest.approx(20.0, abs=1e-9)
    assert variance == pytest.approx((1 + width**2) / 12 + 0.7**2, rel=0.03)


def test_two_shifts_are_refused() -> None:
    with pytest.raises(InputError, match="3 distinct shifts"):
        grouped(fringe(8.0, 2))[0].solve()
