"""From the mean over a pixel's area to the value at its centre.

A pixel integrates light over its area. Curvature of the map and a gradient of light inside the pixel shift
the mean from the centre's value. The shift that neighbours determine beyond noise is subtracted. The rest (a
step inside the pixel, a curvature that changes from pixel to pixel) adds variance.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import inlined, kernel

from .profile.border import SHADOW2
from .profile.pixelation import REACH

__all__ = ["BULK", "STEEP", "CentreLimits", "centred", "dark_level", "lesser", "windowed"]

F32 = NDArray[np.float32]
#: Standard deviations beyond which a second difference is signal.
BULK = 2.5
#: Squared second difference over the squared fourth one, of uncorrelated pixels: sums over both axes with 20
#: variances, and with 2 x 70.
_ROUGH = np.float32(20 / 140)
#: Twice the squared fourth differences of noise of variance 1.
_BY_NOISE = np.float32(2 * 140)
#: Squared shares: of a fourth difference, the error of a second one over 24 for waves (1 / sinc - 1, down to
#: 2.4 pixels); of a second difference, all; of the distance of both neighbours (two pixels), the shift of the
#: centre of light by a step or speck of the lesser change of light.
_SHORT, _ALL, _EDGE = np.float32(1 / 64**2), np.float32(1 / 24**2), np.float32(1 / 8**2)
#: Turns of a fringe per pixel beyond which it is not decoded: a quarter of its contrast remains.
STEEP = 0.8


class CentreLimits(NamedTuple):
    """Numbers of a line, float32.

    jump       largest second difference of neighbours of one map, px
    stripe     finest stripe of a code, px (infinite: no code); parts of other stripes in a pixel shift its
               reading
    per_turn   turns of the finest fringe in a px
    reach2     squared reach of a pixel of no footprint, and extent of the surface (infinite: no border), in
               shadow (see border) nothing is subtracted
    dark       level without light; inner (bool): whether there are REACH rows on either side
    lens       variance of the lens blur, px^2 of the camera, and its standard deviation lens_sigma
    footprint  side of a pixel's active area over its pitch
    """

    jump: np.float32
    stripe: np.float32
    per_turn: np.float32
    reach2: np.float32
    extent: np.float32
    dark: np.float32
    inner: bool
    lens: np.float32
    lens_sigma: np.float32
    footprint: np.float32


def dark_level(level: F32, amplitude: F32) -> float:
    """Mean level of pixels without light of the display, from mean levels and amplitudes (K,), grey levels:
    zero of the line through amplitude over level (medians of the dimmest and the brightest third). An
    amplitude is no more than its mean, and ambient light is not negative."""
    mean, swing = (float(np.median(one)) if one.size else 0.0 for one in (level, amplitude))
    if swing <= 0:  # undetermined: no pixels, or black and white exchanged
        return 0.0
    low, high = np.quantile(level, (1 / 3, 2 / 3))
    ends = [(np.median(amplitude[third]), np.median(level[third])) for third in (level <= low, level >= high)]
    (a, b), (c, d) = ends
    share = float(np.clip((c - a) / max(d - b, 1e-6), swing / max(mean, 1e-6), 1.0))
    return mean - swing / share


@kernel
def windowed(coord: F32, flags: NDArray[np.uint16], start: int, stop: int, out: F32) -> None:
    """Rows start..stop of a map (H, W) with REACH pixels on every side, (stop - start + 2 REACH,
    W + 2 REACH): flagged pixels are NaN. Two pixels beyond the image continue the parabola through the last
    three."""
    rows, cols = coord.shape
    out[:] = np.float32(np.nan)
    first, left, right = start - REACH, REACH, REACH + cols - 1
    for y in range(max(first, 0), min(stop + REACH, rows)):
        _good_only(coord[y], flags[y], out[y - first, left : right + 1])
    top, end = -first, rows - 1 - first
    for k in (1, 2):
        for x in range(out.shape[1]):
            if rows > 2 and top >= k:
                out[top - k, x] = _parabola(out[top, x], out[top + 1, x], out[top + 2, x], k)
            if rows > 2 and end + k < len(out):
                out[end + k, x] = _parabola(out[end, x], out[end - 1, x], out[end - 2, x], k)
        for y in range(len(out) if cols > 2 else 0):
            out[y, left - k] = _parabola(out[y, left], out[y, left + 1], out[y, left + 2], k)
            out[y, right + k] = _parabola(out[y, right], out[y, right - 1], out[y, right - 2], k)


@kernel
def _good_only(line: F32, flags: NDArray[np.uint16], out: F32) -> None:
    for x in range(line.size):
        out[x] = line[x] if flags[x] == 0 else np.float32(np.nan)


@inlined
def _parabola(end: np.float32, next_: np.float32, third: np.float32, k: int) -> np.float32:
    """Extrapolate the parabola through three values to k = 1 or 2 beyond its end."""
    one = np.float32(3) * (end - next_) + third
    return one if k == 1 else np.float32(3) * (one - end) + next_


@kernel
def centred(
    here: F32,
    window: F32,
    k: int,
    light: tuple[F32, F32, F32],
    limits: CentreLimits,
    out: F32,
    total: F32,
) -> None:
    """From the mean over a pixel, weighted by the light, to its centre, along a line (W,).

    Of u(s) = u + g s + s H s / 2 and light A (1 + a s) the mean over a pixel is u + (H_xx + H_yy) / 24 +
    a g / 12; of a fringe, and behind a lens, see `_mixed`. For the light's gradient only the pixel's own area
    is corrected: at a falloff of light the lens has changed the gradient, too.
    here: the line. window: see `windowed`, k: the line's row in it. light: of the line, (W + 4,) with its
    ends repeated, and of the rows two above and two below (W,).

    Over REACH pixels the curvature has almost no noise. It is shrunk by its noise (James and Stein), and so
    is its difference to the curvature between nearest neighbours. That difference is also shrunk by its
    change from pixel to pixel (a rough mirror, a neighbour at an edge).
    """
    jump, stripe, per_turn, reach2, extent, dark, inner, lens2, lens_sigma, footprint = limits
    zero, half, two, four = np.float32(0), np.float32(0.5), np.float32(2), np.float32(4)
    wide, twelfth = np.float32(1 / REACH**2), np.float32(1 / 12)
    area2 = footprint * footprint
    m2 = twelfth * area2 + lens2
    unsure2 = lens_sigma * lens_sigma
    part = half * m2
    # squared shifts over those by the pixel's area alone
    blurred2 = np.float32(24**2) * part * part
    # weights: 1 + 4 part for the pixel, part for each of four neighbours
    more = np.float32(8) * part + np.float32(20) * part * part
    unsure = np.float32(20 * BULK**2)
    # twice the relative variance of a difference of mean levels, over the variance of a place
    grain = np.float32(2 * (2 * np.pi) ** 2) * per_turn * per_turn
    # largest squared fourth difference by second ones of one map: beyond, it is an edge (see spatial)
    most = np.float32(2 * 4**2) * jump * jump
    size, at = out.size, REACH
    first, last = np.int32(at), np.int32(size - 1 - at)
    # views of equal length: the compiler knows that a rising index does not wrap round
    line = window[k]
    left, right = line[at - 1 : at - 1 + size], line[at + 1 : at + 1 + size]
    left_2, right_2 = line[at - 2 : at - 2 + size], line[at + 2 : at + 2 + size]
    left_far, right_far = line[:size], line[2 * at : 2 * at + size]
    up, down = window[k - 1, at : at + size], window[k + 1, at : at + size]
    up_2, down_2 = window[k - 2, at : at + size], window[k + 2, at : at + size]
    up_far, down_far = window[k - at, at : at + size], window[k + at, at : at + size]
    before_up, after_up = window[k - 1, at - 1 : at - 1 + size], window[k - 1, at + 1 : at + 1 + size]
    before_down, after_down = window[k + 1, at - 1 : at - 1 + size], window[k + 1, at + 1 : at + 1 + size]
    bright, bright_up, bright_down = light
    before, lit, after = bright[:size], bright[2 : 2 + size], bright[4 : 4 + size]
    for x in range(size):
        u, was = here[x], out[x]
        one_x, one_y = right[x] - left[x], down[x] - up[x]
        two_x, two_y = right_2[x] - left_2[x], down_2[x] - up_2[x]
        near_x, near_y = left[x] + right[x] - two * u, up[x] + down[x] - two * u
        fourth_x = left_2[x] + right_2[x] - two * u - four * near_x
        fourth_y = up_2[x] + down_2[x] - two * u - four * near_y
        broad_x = (left_far[x] + right_far[x] - two * u) * wide
        broad_y = (up_far[x] + down_far[x] - two * u) * wide
        bend, uneven = near_x + near_y, fourth_x * fourth_x + fourth_y * fourth_y
        # a flagged neighbour makes its differences NaN
        near, next_ = bend == bend, uneven == uneven
        # an index as wide as the values: a wider one would halve the SIMD lanes
        inside = inner & (np.int32(x) >= first) & (np.int32(x) <= last)
        far = inside & next_ & (broad_x + broad_y == broad_x + broad_y)
        noise = unsure * (total[x] + (was - u) * (was - u))
        turns_x, turns_y = half * one_x * per_turn, half * one_y * per_turn
        pole_x, pole_y = _poles(footprint * turns_x, footprint * turns_y)
        factor_x, across_x = _mixed(turns_x, pole_x, lens2, footprint)
        factor_y, across_y = _mixed(turns_y, pole_y, lens2, footprint)
        broad_x, broad_y = broad_x if far else zero, broad_y if far else zero
        ragged = max(uneven - _BY_NOISE * total[x], zero) if next_ else zero
        there = _beyond(broad_x + broad_y, max(noise * wide * wide, _ROUGH * ragged))
        bend_x, bend_y = near_x - there * broad_x, near_y - there * broad_y
        bend = bend_x + bend_y if near else zero
        share = _beyond(bend, max(noise, _ROUGH * uneven)) if next_ else zero
        bends = factor_x * (there * broad_x + share * bend_x) + factor_y * (there * broad_y + share * bend_y)
        turned = np.float32(24 / 4) * across_x * across_y
        # shrunk by the disagreement of the four quarters: one outlying neighbour makes it as large as the
        # twist, or half as large at the image's border, where values are extrapolated
        along, against = before_up[x] + after_down[x], before_down[x] + after_up[x]
        differ = along + against - four * u - two * (near_x + near_y)
        twist = (along - against) * _beyond(along - against, four * differ * differ) * turned
        twisted = near & (twist == twist)
        bends -= twist if twisted else zero
        whole = min(bend * bend, four * jump * jump)
        short = (min(ragged, most) * _SHORT if next_ else whole * _ALL) * blurred2
        grain2 = grain * total[x]
        edge_x, light_x = _in_light(before[x], lit[x], after[x], dark, half * grain2)
        edge_y, light_y = _in_light(bright_up[x], lit[x], bright_down[x], dark, half * grain2)
        # of a code it is below the rounding to cells and the noise of the light
        dims = area2 * (light_x * one_x + light_y * one_y) if stripe == np.float32(np.inf) else zero
        edge_x = max(edge_x * edge_x - grain2, zero) * one_x * one_x
        edge_y = max(edge_y * edge_y - grain2, zero) * one_y * one_y
        edges = (edge_x + edge_y) * _EDGE if near else zero
        jump_x = _jump(one_x, two_x, right_far[x] - left_far[x]) if far else two * one_x - two_x
        jump_y = _jump(one_y, two_y, down_far[x] - up_far[x]) if far else two * one_y - two_y
        # each axis by itself: a flagged pixel on one does not affect the other
        jump_x, jump_y = jump_x if jump_x == jump_x else zero, jump_y if jump_y == jump_y else zero
        jumps = max(jump_x * jump_x + jump_y * jump_y - two * noise, zero)
        smooth = near & (near_x * near_x < jump * jump) & (near_y * near_y < jump * jump)
        # outside the border's shadow, as are neighbours two pixels away
        steps_x, steps_y = one_x if one_x == one_x else zero, one_y if one_y == one_y else zero
        away = max(min(u + half, extent - half - u) - max(abs(steps_x), abs(steps_y)), zero)
        width2 = (steps_x * steps_x + steps_y * steps_y) * np.float32(1 / 48)
        clear = away * away > SHADOW2 * (reach2 + width2)
        off, taken = bends + dims, smooth & clear
        # shift of the centre by a variance of 1 on top of m2
        by_m2 = half * (there * (broad_x + broad_y) + share * (bend_x + bend_y) if near else zero)
        by_m2 += light_x * one_x + light_y * one_y if dims != zero else zero
        out[x] = was - (np.float32(1 / 24) * off if taken else zero)
        least_x, least_y = lesser(u - left[x], right[x] - u), lesser(u - up[x], down[x] - u)
        over = max(least_x + least_y - stripe, zero)
        # bound by the curvature of a ridge, where a diagonal neighbour is flagged
        bent = near_x * near_y * turned * turned * np.float32(16)
        short += abs(bent) * _ALL if near & (not twisted) else zero
        # next-order terms are smaller than these by a factor of turns squared
        most_turns = turns_x * turns_x + turns_y * turns_y
        size_of = abs(factor_x * near_x) + abs(factor_y * near_y) + (abs(twist) if twisted else zero)
        short += size_of * size_of * most_turns * most_turns * _ALL if near else zero
        short += off * off * _ALL if near & (not taken) else zero
        short += by_m2 * by_m2 * unsure2 if near & taken else zero
        # at a falloff of light neighbours are shifted (see ends), which adds apparent curvature
        scale = np.float32(1) / max(lit[x] - dark, np.float32(1e-6))
        fall_x = max(abs(after[x] - lit[x]), abs(before[x] - lit[x])) * scale
        fall_y = max(abs(bright_down[x] - lit[x]), abs(bright_up[x] - lit[x])) * scale
        fades = np.float32(0.25) * m2 * part * (abs(one_x) * fall_x + abs(one_y) * fall_y)
        doubt = short + (fades * fades if near else zero)
        doubt += edges + jumps * twelfth if clear else whole * _ALL
        total[x] += doubt + (share * more * total[x] if smooth else zero) + over * over * twelfth


@inlined
def _poles(one: np.float32, other: np.float32) -> tuple[np.float32, np.float32]:
    """1 / (1 - w^2) of both numbers of turns, by one division; |w| is limited to STEEP."""
    a = np.float32(1) - min(one * one, np.float32(STEEP**2))
    b = np.float32(1) - min(other * other, np.float32(STEEP**2))
    both = np.float32(1) / (a * b)
    return b * both, a * both


@inlined
def _mixed(
    turns: np.float32, pole: np.float32, lens2: np.float32, footprint: np.float32
) -> tuple[np.float32, np.float32]:
    """Phase shift of a fringe with w turns per pixel by curvature along an axis, over H_xx / 24; and c of the
    mixed derivative, which shifts the phase by -H_xy c(w_x) c(w_y).

    A pixel of side f behind a lens has the MTF M(w) = sinc(f w) exp(-2 pi^2 lens2 w^2); the shifts are
    -12 M'' / (4 pi^2 M) and -M' / (2 pi M). For sinc(w) alone, the pole at 1 and the first term of the
    remaining series give (the first to 0.01 up to half a turn, to 8 % near one)
    1 - 2 pi^2 / 15 w^2 / (1 - w^2) and (w / pi) (1 / (1 - w^2) + pi^2 / 6 - 1); pole: of f w.
    """
    one, pi, most = np.float32(1), np.float32(np.pi), np.float32(2 * np.pi**2 / 15)
    area2 = footprint * footprint
    own, through = area2 * turns / pi * (pole + np.float32(np.pi**2 / 6 - 1)), pi * lens2 * turns
    blurred = lens2 * (one - np.float32(4) * pi * turns * (own + through))
    return area2 * (one + most - most * pole) + np.float32(12) * blurred, own + through + through


@inlined
def lesser(one: np.float32, other: np.float32) -> np.float32:
    """The smaller magnitude of two changes; the other one where one is NaN (flagged), 0 if both are."""
    one, other = abs(one), abs(other)
    least = one if (one < other) | (other != other) else other
    return least if least == least else np.float32(0)


@inlined
def _beyond(value: np.float32, noise: np.float32) -> np.float32:
    """Shrinkage factor max(1 - noise / value^2, 0); noise: variance."""
    return max(np.float32(1) - noise / (value * value + np.float32(1e-12)), np.float32(0))


@inlined
def _jump(one: np.float32, two: np.float32, four: np.float32) -> np.float32:
    """Step J of g x + k x^3 + J sign(x) / 2, from differences over 2, 4 and 8 pixels; its variance is 14.6
    times a pixel's. (g x + J sign(x) / 2 by the first two: 2 one - two, 10 times.)"""
    return (four - np.float32(10) * two + np.float32(16) * one) * np.float32(1 / 7)


@inlined
def _in_light(
    before: np.float32, here: np.float32, after: np.float32, dark: np.float32, noise: np.float32
) -> tuple[np.float32, np.float32]:
    """Lesser of the relative changes of light to both pixels two pixels away (same colour of a mosaic): its
    magnitude; and the change per pixel, reduced by the difference of both beyond noise (variance of a
    change), 0 if their signs differ (minmod: no gradient at an edge). At most 2: light is not negative inside
    the pixel. dark: level without light."""
    half, scale = np.float32(0.5), np.float32(1) / max(here - dark, np.float32(1e-6))
    mean, bend = half * (after - before) * scale, abs(half * (before + after) - here) * scale
    sure = bend * _beyond(bend, np.float32(0.75 * BULK**2) * noise)
    least, most = max(abs(mean) - sure, np.float32(0)), np.float32(2)
    return min(abs(abs(mean) - bend), most), half * min(least, most) * np.sign(mean)
