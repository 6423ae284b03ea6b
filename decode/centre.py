"""From the mean over a pixel, which is what it reads, to what its centre sees.

A pixel takes light all over its area. Where the map bends inside of it, or its light is a slope, the mean is
not the centre's value: that comes off as far as neighbours show it beyond noise, and what they cannot tell (a
jump inside of the pixel, a bend that changes from pixel to pixel) goes into the variance.
"""

from typing import Any

import numpy as np

from optolever.kernels import inlined, kernel

from .display import REACH

__all__ = ["BULK", "centred"]

#: Second differences are of the map from so many deviations on; what curvature may be told wrong by:
#: a fifth of a wave of four pixels, the shortest whose phase a pixel tells.
BULK, _LEFT = 2.5, 0.2**2
#: Squared curvature over next neighbours, of its squared differences from that over neighbours two pixels
#: away, on a map whose pixels have nothing to do with each other: 20 / (2 (2 + (3 / 2)^2 + 2 / 4^2)).
_ROUGH = 20 / 8.75


@kernel
def centred(
    span: Any,
    c: Any,
    above: Any,
    below: Any,
    light: Any,
    flags: Any,
    flags_above: Any,
    flags_below: Any,
    jump: Any,
    out: Any,
    total: Any,
) -> None:
    """From the mean over a pixel, weighted by the light, to its centre.

    Of u(s) = u + g s + s H s / 2 and light A (1 + a s) the mean over a pixel is u + (H_xx + H_yy) / 24 +
    a g / 12.
    span: first pixel, one after the last, reach: REACH, or 2 where the image ends before that. above, below:
    the rows 1, 2 and reach away, with their flags. Over REACH pixels the curvature is told with next to no
    noise; it, and what it is more or less between next neighbours, count as far as they are beyond noise, and
    the latter as far as neighbours two pixels away show it, too (James and Stein's shrinkage): what changes
    from pixel to pixel (a rough mirror, a neighbour at an edge) is no curvature and goes into the variance.
    Where next neighbours bend by `jump` there is no map.
    """
    first, end, reach = span
    zero, two, four, quarter = np.float32(0), np.float32(2), np.float32(4), np.float32(0.25)
    wide, part, twelfth = np.float32(1 / REACH**2), np.float32(1 / 24), np.float32(1 / 12)
    unsure, more = np.float32(20 * BULK**2), np.float32((7 / 6) ** 2 + 4 / 24**2 - 1)
    rough = np.float32(_ROUGH)
    some, all_of_it = np.float32(_LEFT / 24**2), np.float32(1 / 24**2)
    whole = reach == REACH
    # views of one length: an index that only counts up is known not to wrap round
    here, left, right = c[first:end], c[first - 1 : end - 1], c[first + 1 : end + 1]
    left_2, right_2 = c[first - 2 : end - 2], c[first + 2 : end + 2]
    left_far, right_far = c[first - reach : end - reach], c[first + reach : end + reach]
    up, up_2, up_far = above[0][first:end], above[1][first:end], above[2][first:end]
    down, down_2, down_far = below[0][first:end], below[1][first:end], below[2][first:end]
    bad_left, bad_right = flags[first - 1 : end - 1], flags[first + 1 : end + 1]
    bad_left_2, bad_right_2 = flags[first - 2 : end - 2], flags[first + 2 : end + 2]
    bad_left_far, bad_right_far = flags[first - reach : end - reach], flags[first + reach : end + reach]
    bad_up, bad_up_2, bad_up_far = (
        flags_above[0][first:end],
        flags_above[1][first:end],
        flags_above[2][first:end],
    )
    bad_down, bad_down_2, bad_down_far = (
        flags_below[0][first:end],
        flags_below[1][first:end],
        flags_below[2][first:end],
    )
    bright, bright_up, bright_down = light[0][first:end], light[1][first:end], light[2][first:end]
    bright_left, bright_right = light[0][first - 1 : end - 1], light[0][first + 1 : end + 1]
    shifted, variance = out[first:end], total[first:end]
    for x in range(here.size):
        near = (bad_left[x] | bad_right[x] | bad_up[x] | bad_down[x]) == 0
        next_ = near & ((bad_left_2[x] | bad_right_2[x] | bad_up_2[x] | bad_down_2[x]) == 0)
        far = (bad_left_far[x] | bad_right_far[x] | bad_up_far[x] | bad_down_far[x]) == 0
        far &= next_ & whole
        u, was = here[x], shifted[x]
        noise = unsure * (variance[x] + (was - u) * (was - u))
        broad = (left_far[x] + right_far[x] + up_far[x] + down_far[x] - four * u) * wide if far else zero
        broad *= _beyond(broad, noise * wide * wide)
        bend_x, bend_y = left[x] + right[x] - two * u, up[x] + down[x] - two * u
        bend = bend_x + bend_y - broad if near else zero
        off_x = bend_x - quarter * (left_2[x] + right_2[x] - two * u)
        off_y = bend_y - quarter * (up_2[x] + down_2[x] - two * u)
        uneven = max(rough * (off_x * off_x + off_y * off_y) - noise, zero) if next_ else zero
        share = _beyond(bend, noise + uneven) if next_ else zero
        one_x, one_y = right[x] - left[x], down[x] - up[x]
        two_x, two_y = right_2[x] - left_2[x], down_2[x] - up_2[x]
        turn_x, turn_y = two_x - two * one_x, two_y - two * one_y
        turn = quarter * (turn_x * turn_x + turn_y * turn_y) if next_ else zero
        dims = _limited(bright_left[x], bright[x], bright_right[x]) * one_x
        dims += _limited(bright_up[x], bright[x], bright_down[x]) * one_y
        dims = dims / max(bright[x], np.float32(1e-6)) if near else zero
        jump_x = _jump(one_x, two_x, right_far[x] - left_far[x])
        jump_y = _jump(one_y, two_y, down_far[x] - up_far[x])
        jumps = jump_x * jump_x + jump_y * jump_y - two * noise if far else zero
        doubt = (some if next_ else all_of_it) * max(bend * bend + turn - noise, zero) + all_of_it * uneven
        doubt += max(jumps, zero) * twelfth + share * more * variance[x]
        smooth = bend * bend < jump * jump
        shifted[x] = was - (part * (broad + share * bend + dims) if smooth else zero)
        variance[x] += doubt if smooth else zero


@inlined
def _beyond(value: Any, noise: Any) -> Any:
    """Share of a value that is beyond noise (variance)."""
    return max(np.float32(1) - noise / (value * value + np.float32(1e-12)), np.float32(0))


@inlined
def _jump(one: Any, two: Any, four: Any) -> Any:
    """J by differences over 2, 4 and 8 pixels of g x + k x^3 + J sign(x) / 2; its variance is 14.6 times that
    of a pixel."""
    return (four - np.float32(10) * two + np.float32(16) * one) * np.float32(1 / 7)


@inlined
def _limited(before: Any, here: Any, after: Any) -> Any:
    """The lesser of both differences, 0 if their signs differ: beside an edge no gradient (minmod)."""
    one, other = here - before, after - here
    least = min(abs(one), abs(other))
    least = least if one > np.float32(0) else -least
    return least if one * other > np.float32(0) else np.float32(0)
