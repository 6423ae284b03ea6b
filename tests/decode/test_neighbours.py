"""What a pixel's neighbours tell: bends, steep codes, mixed footprints, the border's shadow."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import Flag, decode
from optolever.decode.profile.border import BorderBlur, border_of, inwards
from optolever.experiments.metrics import rms
from optolever.patterns import sequence, sequence_from_text

from .conftest import Map, Shoot, scores, silent
from .footprints import FINE, centres, footprints, places


def test_the_mixed_second_derivative_is_taken_off() -> None:
    """Of a fringe it shifts a mean by u_xy sinc'(w_x) sinc'(w_y) / (4 pi^2 sinc(w_x) sinc(w_y)), w turns."""
    row, col = places(17, 17)
    u = 70 + 3.0 * (col - 8) + 3.0 * (row - 8) + 0.15 * (col - 8) * (row - 8)
    v = 20 + row
    found = decode(
        footprints(sequence("gray+phase", 60, 160), u, v, noise=0.3), sequence("gray+phase", 60, 160)
    )
    w, step = 3.0 / 8, 1e-4
    slope = (np.sinc(w + step) - np.sinc(w - step)) / (2 * step) / (2 * np.pi * np.sinc(w))
    inner = np.s_[4:-4, 4:-4]
    assert found.good[inner].all()
    assert abs((found.u - centres(u))[inner].mean()) < 0.15 * slope**2 / 4


@pytest.mark.daily(2)
@pytest.mark.parametrize("name", ["phase", "gray+phase", "stripe:step=4", "gray"])
def test_beside_a_hole(name: str) -> None:
    """Pixels whose footprint is half in a hole see the mean of what is left; steep maps make that matter."""
    shown = sequence_from_text(name, 120, 150)
    row, col = places(60, 64)
    distance = np.hypot(row - 30, col - 32)
    u = 10 + 2 * col + 30 * np.exp(-((distance / 9) ** 2)) * (col - 32) / 9
    v = 5 + 1.8 * row
    hole = (distance < 7.3).astype(float)
    found = decode(footprints(shown, u, v, dark=hole), shown)
    assert (
        silent(found, centres(u), centres(v), least=1.5 if name == "gray" else 0.0) <= 1e-4 + 1 / found.u.size
    )
    assert found.good[(np.abs(centres(distance) - 7.3) > 3.5) & (centres(distance) > 7.3)].mean() > 0.9


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", ["phase:steps=8", "gray+phase", "micro-phase"])
@pytest.mark.parametrize("first", [0, 30])
def test_a_bend_that_no_two_neighbours_of_a_side_tell_is_in_sigma(name: str, first: int) -> None:
    """Two rows alone, between which the map turns: they hardly differ, means are an eighth of a px off."""
    row, col = places(60, 64)
    u, v = 60 + 1.5 * (row - first - 0.5 - 0.01 * (col - 32)) ** 2, 8 + 1.5 * col
    dark = (row < first - 0.5) | (row > first + 1.5)
    shown = sequence_from_text(name, 110, 130)
    found = decode(footprints(shown, u, v, noise=0.5, dark=dark.astype(float)), shown)
    assert silent(found, centres(u), centres(v)) == 0.0
    assert found.good.sum() > 100
    assert np.median(found.sigma_u[found.good]) < 0.4


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", ["phase:steps=4", "stripe"])
def test_a_ridge_beside_pixels_that_are_refused(name: str) -> None:
    """A slanted rim, steeper towards its crest, moves the mean of a pixel off its centre; dust above or below
    takes nothing of what the pixels to the left and right tell of that."""
    row, col = places(60, 64)
    crest = 32 + 0.2 * (row - 30)
    away = col - crest
    u, v = 66 + 0.4 * away + np.where(away < 0, 4 * np.exp(away / 1.1), 4 - 1.8 * away), 8 + 1.8 * row
    whole = np.rint(row), np.rint(col)
    dust = (whole[0] % 5 == 0) & (np.abs(whole[1] - np.rint(32 + 0.2 * (whole[0] - 30))) < 2)
    shown = sequence_from_text(name, 120, 110)
    found = decode(footprints(shown, u, v, noise=0.3, dark=dust.astype(float)), shown)
    # of 16 draws of stripes 4 have a pixel, or two, beyond
    assert silent(found, centres(u), centres(v)) <= 1e-4 + 1 / found.u.size
    assert found.good.mean() > 0.9


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", ["gray+phase", "stripe"])
@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_mirror_that_ends_in_the_images_outermost_pixels(turns: int, name: str) -> None:
    """Its slanted edge leaves a part of each; nothing beyond the image tells that, their lost light does."""
    row, col = places(60, 60)
    u, v = (np.rot90(part, turns) for part in (10 + 2.3 * col, 8 + 2.2 * row))
    dark = np.rot90(row < col / 60 - 0.6, turns)
    shown = sequence_from_text(name, 150, 160)
    found = decode(footprints(shown, u, v, noise=0.3, dark=dark), shown)
    assert silent(found, centres(u), centres(v)) <= 1e-4
    lit = np.rot90(found.sigma_u, -turns)[[0, -1], 2:20]
    assert found.good.mean() > 0.97
    assert np.median(lit) < 0.03


@pytest.mark.daily(2)
@pytest.mark.parametrize("blur", [0.5, 3.0])
@pytest.mark.parametrize("name", ["phase", "phase:steps=4,periods=20/22/25", "stripe:step=8", "gray"])
def test_the_shadow_of_the_border(name: str, blur: float) -> None:
    """A pixel near the border gets less light from beyond it, which moves what it sees inward."""
    shown = sequence_from_text(name, 90, 100)
    row, col = places(80, 100)
    found = decode(footprints(shown, col, row + 5.0, blur=blur), shown)
    assert silent(found, centres(col), centres(row) + 5.0, least=1.5 if name == "gray" else 0.0) <= 1e-4
    inner = np.abs(centres(col) - 49.5) < 49.5 - 4 * blur - 2
    if name != "gray" or blur < 1:
        assert found.good[inner].mean() > 0.97


@pytest.mark.daily(1)
@pytest.mark.parametrize("turned", [False, True])
def test_what_only_looks_like_the_borders_shadow(turned: bool, shoot: Shoot) -> None:
    """A dim band near the border, brighter again on the border's side (a slope that reflects less)."""
    shown = sequence("phase", 100, 100, steps=4, periods=(13.0, 12.5))
    v, u = np.mgrid[:100, :100].astype(np.float64)
    inside = v if turned else 99 - u
    light = 90 * (1 - 0.2 * np.exp(-(((inside - 8) / 3) ** 2)))
    found = decode(shoot(shown, u, v, noise=0.5, offset=light + 10, amplitude=light), shown)
    band = (inside > 3) & (inside < 14) & (np.abs(u - 49) < 30 if turned else np.abs(v - 49) < 30)
    assert found.good[band].mean() > 0.99
    fading = 90 * (1 - 0.5 * np.exp(-(((inside + 1) / 3) ** 2)))
    found = decode(shoot(shown, u, v, noise=0.5, offset=fading + 10, amplitude=fading), shown)
    assert (found.flags[band & (inside < 4)] & Flag.OUTLIER).all()


@pytest.mark.parametrize("place", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("cells", [0.3, 1.2])
def test_what_an_unsure_blur_shifts_is_in_sigma(cells: float, place: float) -> None:
    """What it would shift if it were the least or the largest, at the same place and footprint."""

    def shift_of(*blurs: float) -> tuple[float, float]:
        border = border_of(((8.0, 1.0),), BorderBlur(*blurs, True))
        none, width = np.float32(0), np.float32(cells)
        return inwards(np.float32(place), none, width, none, border.reach, border.table, 500.0)[1:]

    middle, variance = shift_of(0.8, 0.85, 0.9)
    ends = [abs(shift_of(blur, blur, blur)[0] - middle) for blur in (0.8, 0.9)]
    assert np.sqrt(variance) == pytest.approx(max(ends), rel=0.1)


@pytest.mark.parametrize("depth", [0.15, 0.35, 0.5])
def test_light_that_falls_off_is_no_border(depth: float, shoot: Shoot) -> None:
    """A vignette or an uneven backlight darkens the pattern's rim as its border would, but shifts nothing."""
    shown = sequence("gray+phase", 100, 100)
    v, u = 4 + 0.9 * np.mgrid[:100, :100]
    away = np.minimum(np.minimum(u, 99 - u), np.minimum(v, 99 - v)) + 0.5
    light = 90 * (1 - depth * np.exp(-away / 4))
    found = decode(shoot(shown, u, v, noise=0.5, offset=light + 10, amplitude=light), shown)
    rim = found.good & (away < 9)
    assert rim.sum() > 0.9 * np.count_nonzero(away < 9)
    for coordinate, truth in ((found.u, u), (found.v, v)):
        assert abs(float(np.mean((coordinate - truth)[rim & (truth < 9)]))) < 0.01


def test_a_pixel_that_looks_elsewhere_bends_no_map_beside_it(shoot: Shoot) -> None:
    """As a hot one does: none of its neighbours is moved, not those across its corners either."""
    row, col = np.mgrid[:40, :60].astype(np.float64)
    u, v = 10 + 1.7 * col + 1.4 * row, 60 + 1.7 * row - 0.9 * col
    shown = sequence("gray+phase", 150, 180)
    seen, elsewhere = shoot(shown, u, v, noise=0.5), shoot(shown, u + 7, v + 5, noise=0.5)
    one = (row % 9 == 4) & (col % 9 == 4)
    found = decode(np.where(one, elsewhere, seen), shown)
    assert found.good[~one].mean() > 0.8
    assert (np.abs(scores(replace(found, flags=found.flags | one), u, v)) < 5).all()


def test_bends_are_taken_off_up_to_the_images_border() -> None:
    """Waves with crests on the image's border: of the shift by the bend a third is left there at most."""
    row, col = places(40, 53)
    height = 1.6 * np.cos(2 * np.pi * row / 13) + 1.6 * np.cos(2 * np.pi * col / 13)
    u, v = 40 + 1.5 * col + height, 20 + row
    shown = sequence("gray+phase", 80, 160)
    found = decode(footprints(shown, u, v, noise=0.3), shown)
    assert silent(found, centres(u), centres(v)) <= 1e-4
    assert found.good.mean() > 0.99
    shift = 1.6 * (2 * np.pi / 13) ** 2 / 24
    for border in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        assert abs((found.u - centres(u))[border].mean()) < shift / 3


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", ["gray+phase", "micro-phase"])
def test_light_that_steps_inside_of_a_pixel_is_in_sigma(name: str) -> None:
    """Behind a slanted edge a quarter of the light is left: pixels on it see one side more than the other."""
    row, col = places(60, 80)
    u, v = 10 + 1.7 * col, 8 + 1.5 * row
    dark = np.where(col + 0.13 * row > 44, 0.75, 0.0)
    shown = sequence(name, 120, 160)
    found = decode(footprints(shown, u, v, noise=0.3, dark=dark), shown)
    assert silent(found, centres(u), centres(v)) <= 1e-3
    assert found.good.mean() > 0.97
    flat = np.abs(centres(col) + 0.13 * centres(row) - 44) > 4
    assert np.median(found.sigma_u[flat & found.good]) < 0.03


def test_what_falling_light_shifts_is_taken_off_above_a_dark_level() -> None:
    """A pixel's mean is off by g a / 12, a the relative slope of the light alone: neighbours' noise hides
    some of it, and a third of the level is dark current."""
    row, col = places(60, 80)
    u, v = 10 + 1.7 * col, 8 + 1.5 * row
    falling = col / 160
    shown = sequence("gray+phase", 120, 160)
    found = decode(footprints(shown, u, v, noise=0.3, dark=falling) + np.uint8(30), shown)
    shift = -1.7 / 160 / (1 - centres(falling)) / 12
    inner = found.good & (np.abs(centres(col) - 40) < 35)
    error = (found.u - centres(u))[inner]
    assert abs(error @ shift[inner]) < 0.2 * (shift[inner] ** 2).sum()


@pytest.mark.daily(1)
@pytest.mark.parametrize("name", ["gray+phase", "phase:steps=3,periods=8.73782/8.05745/8"])
def test_behind_a_mosaic_of_colours(name: str) -> None:
    """Next neighbours of a raw colour camera differ by their colour: that is no edge, neither in the mirror
    nor beside its slanted end."""
    row, col = places(72, 90)
    u, v = 10 + 1.7 * col + 0.004 * (row - 30) ** 2, 8 + 1.5 * row
    colours = np.kron(np.tile([[0.5, 1.0], [1.0, 0.35]], (36, 45)), np.ones((FINE, FINE)))
    seen = colours * (row + 0.11 * col > 12)
    shown = sequence_from_text(name, 120, 170)
    found = decode(footprints(shown, u, v, noise=0.7, dark=1 - seen), shown)
    assert silent(found, centres(u), centres(v)) == 0
    assert found.good.mean() > 0.75
    inner = found.good & (centres(row) + 0.11 * centres(col) > 15)
    score = ((found.u - centres(u)) / found.sigma_u)[inner]
    assert 0.65 < np.sqrt(np.mean(score**2)) < 1.12


def test_places_by_chance_are_no_map(shoot: Shoot) -> None:
    """Neighbours that have nothing to do with each other (a test of a decoder, a diffuser) flag nothing."""
    shown = sequence("phase", 100, 100, periods=(112.5, 16.0))
    u, v = np.random.default_rng(0).uniform(10, 89, (2, 60, 70))
    found = decode(shoot(shown, u, v, noise=1.0), shown, on_cells=False)
    assert ((found.flags & Flag.OUTLIER) > 0).mean() < 0.01
    assert found.good.mean() > 0.99
    assert rms(scores(found, u)) == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("code", ["xor-gray", "gray"])
def test_pixels_that_look_right_among_those_too_wide_for_a_code(code: str) -> None:
    """Five cells a pixel: two neighbours may alias to places side by side, all others are doubtful. A Gray
    code is read by wider cells instead."""
    row, col = places(110, 120)
    u, v = 6 + 2.75 * col + 1.5 * np.sin(row / 40), 9 + 5.15 * row
    shown = sequence(code, 600, 350)
    found = decode(footprints(shown, u, v, blur=0.1, noise=0.4), shown)
    assert silent(found, centres(u), centres(v)) == 0
    assert found.good.mean() > 0.99 if code == "gray" else found.good.mean() < 2e-3


def test_a_row_that_leaves_both_rows_beside_it_is_flagged(shoot, smooth: Map) -> None:
    """A light that flashes while a row is read moves all of it: along the row, nothing is wrong."""
    u, v = smooth
    moved = v.copy()
    moved[40] += 64.0
    shown = sequence("phase", 300, 170, periods=(320.0, 16.0), steps=4)
    found = decode(shoot(shown, u, moved, noise=1.0), shown, on_cells=False)
    assert (found.flags[40] & Flag.OUTLIER > 0).all()
    assert found.good[np.arange(len(v)) != 40].mean() > 0.99
    # where the map itself jumps, neighbours above and below do not agree
    moved[41:] += 64.0
    torn = decode(shoot(shown, u, moved, noise=1.0), shown, on_cells=False)
    assert torn.good.mean() > 0.97


@pytest.mark.daily(1)
@pytest.mark.parametrize("steepest", [12.0, 16.0, 18.0, 20.0, 24.0])
def test_fringes_of_which_more_than_one_lies_on_a_pixel_are_flagged(steepest: float) -> None:
    """Their contrast is the other way round, half a period off, and a Gray code's cell agrees by chance."""
    shown = sequence_from_text("gray+phase:steps=4,period=14", 120, 240)
    row, col = places(60, 64)
    u = 100 + 0.8 * (col - 32) + 3 * steepest * np.tanh((col - 32 - 0.1 * (row - 30)) / 3)
    v = 20 + 0.9 * row
    found = decode(footprints(shown, u, v, noise=0.5), shown)
    assert silent(found, centres(u), centres(v)) <= 1e-4
    assert found.good[np.abs(centres(col) - 32 - 0.1 * (centres(row) - 30)) > 6].mean() > 0.99


def test_what_noise_lets_pass_among_refused_pixels_is_flagged(
    shoot: Shoot,
) -> None:
    """At an amplitude of three sigma, a pixel in a hundred seems to have four; its error goes with it. A line
    of good pixels stays."""
    shown = sequence("phase", 100, 120, periods=(130.0,), steps=4)
    v, u = np.mgrid[5:95, 5:115].astype(np.float64)
    light = np.where(u == 50, 60.0, 6.4)
    found = decode(shoot(shown, u, v, noise=2.0, offset=80, amplitude=light), shown, noise=2.0)
    strong = light > 10
    assert found.good[strong].mean() > 0.95
    left = found.flags[~strong] & np.uint16(0xFFFF ^ Flag.OUTLIER)
    assert np.mean(left == 0) > 5e-3  # there is something to flag
    assert found.good[~strong].mean() < 1e-3


def test_dim_beside_what_hardly_sees_anything(shoot: Shoot, smooth: Map) -> None:
    """Half of its light is gone, and what is left is of one side: also where the pixel beside still has some
    contrast, and only the next one has none."""
    shown, light = sequence("phase", 150, 170), np.full(smooth[0].shape, 60.0)
    light[30, 38:41] = 0.5, 12, 28
    light[60, 40] = 28  # dust
    found = decode(shoot(shown, *smooth, noise=0.5, amplitude=light), shown, on_cells=False)
    assert found.flags[30, 40] == Flag.OUTLIER
    assert found.flags[60, 40] == 0
    assert found.good.mean() > 0.99
