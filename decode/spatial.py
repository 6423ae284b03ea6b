"""Checks of a pixel against its neighbours: its footprint, pixelation by the display's cells, outliers.

A pixel that covers two places at once (at the edge of an object, of a shadow, of the mirror) reads neither.
Edges appear as second differences between neighbours that no single place can have: more than a quarter of
the finest period, or two cells of a code. Next to a flagged pixel, a pixel may be lit only in part. Its lost
amplitude is the dark share, and its centre of light may be off by half of that share of the footprint (across
a slanted end, or behind a lens that blurs, see ends).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact, inlined, kernel

from .centre import BULK, STEEP, CentreLimits, centred, lesser, windowed
from .correspondence import Flag
from .display import PLACES
from .flags import marked, marks_for
from .profile.border import SHADOW2, inwards
from .profile.ends import faded, slope
from .profile.pixelation import REACH, SLIGHT

__all__ = ["Common", "Raw", "SpatialLimits", "SpatialMaps", "SpatialTables", "check_rows", "despeckle"]

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
U32 = NDArray[np.uint32]
#: Flags of a line, variances of it and of the lines above and below.
Own = tuple[U16, F32, F32, F32]
#: Fields of SpatialLimits: jump, per_turn, squared reach, extent; and usual, jump, footprint.
#: The pixel two before along an axis, one before, here, one after, two after.
Five = tuple[np.float32, np.float32, np.float32, np.float32, np.float32]
Limits = tuple[np.float32, np.float32, np.float32, np.float32]
Footprint = tuple[np.float32, np.float32, np.float32]
_OUTLIER, _OFF = int(Flag.OUTLIER), int(Flag.OFF_PATTERN)
#: Squared deviations beyond which a neighbour contradicts, and beyond which a curvature is signal.
_SURE2, _BULK2 = np.float32(6.0**2), np.float32(BULK**2)
#: Relative variance of a fringe's amplitude over that of its place, turns^2.
_TURN2 = np.float32((2 * np.pi) ** 2)
#: Squared shift of a pixel's mean from its centre, over the squared second difference.
_BEND = np.float32(1 / 24**2)


class Raw(NamedTuple):
    """One axis before the spatial checks, (H, W) float32: coordinate and variance, px and px^2."""

    coordinate: F32
    variance: F32


class Common(NamedTuple):
    """Maps of both axes before the checks, (H, W): flags, amplitude, mean level."""

    flags: U16
    amplitude: F32
    offset: F32


class SpatialTables(NamedTuple):
    """Shift and variance of a Pixelation, table of a Border."""

    shift: F32
    unsure: F32
    border: F32


class SpatialLimits(NamedTuple):
    """Numbers of one axis, float32.

    reach      rms blur of a point pixel (see Border), cells; usual: median footprint, cells
    roughness  variance, px^2; least: sigma, px
    extent     of the surface, px; 0: it has no border
    jump       largest second difference of neighbours, px; stripe: finest stripe of a code, px
    per_turn   turns of the finest fringe in a px
    ends       variance of the mirror's edge blur (see ends), px^2 of the camera; dark: level without light
    lens       variance of the lens blur, px^2 of the camera; lens_sigma: its standard deviation
    footprint  side of a pixel's active area over its pitch
    """

    reach: np.float32
    usual: np.float32
    roughness: np.float32
    least: np.float32
    extent: np.float32
    jump: np.float32
    stripe: np.float32
    per_turn: np.float32
    ends: np.float32
    dark: np.float32
    lens: np.float32
    lens_sigma: np.float32
    footprint: np.float32

    @classmethod
    def of(cls, **numbers: float) -> "SpatialLimits":
        """Rounded to float32."""
        return cls(**{name: np.float32(number) for name, number in numbers.items()})


class SpatialMaps(NamedTuple):
    """Results of one axis, (H, W): coordinate, sigma; flags of both axes, or-ed."""

    coordinate: F32
    sigma: F32
    flags: U16


def check_rows(
    rows: tuple[int, int],
    raw: Raw,
    common: Common,
    tables: SpatialTables,
    limits: SpatialLimits,
    out: SpatialMaps,
) -> None:
    """Check rows start..stop of one axis."""
    _check(*rows, raw, common, tables, limits, out)


@exact
def _check(
    start: int,
    stop: int,
    raw: Raw,
    common: Common,
    tables: SpatialTables,
    numbers: SpatialLimits,
    maps: SpatialMaps,
) -> None:
    (coord, variance), (flags, amplitude, offset) = raw, common
    reach, extent, jump, per_turn = numbers.reach, numbers.extent, numbers.jump, numbers.per_turn
    footprint, ends, shift = numbers.footprint, numbers.ends, tables.shift
    out, sigma, out_flags = maps
    rows, cols = coord.shape
    large = (rows > 4) & (cols > 4)
    window = np.empty((stop - start + 2 * REACH, cols + 2 * REACH), np.float32)
    windowed(coord, flags, start, stop, window)
    special, light = marks_for(cols), np.empty(cols + 4, np.float32)
    places, at = np.empty(cols, np.int64), np.empty(cols, np.uint32)
    most = np.float32(shift.size // PLACES - 1)
    border = np.float32(np.inf) if extent <= 0 else extent
    for y in range(start, stop):
        up, down, k = max(y - 1, 0), min(y + 1, rows - 1), y - start + REACH
        own = flags[y], variance[y], variance[up], variance[down]
        _special_line(window, k, own, (jump, per_turn, reach * reach, border), special[:cols])
        if (y == 0) | (y == rows - 1):
            inner = min(2, rows - 1) if y == 0 else max(rows - 3, 0)
            for x in range(cols):
                special[x] |= _dimmer((y, x), (inner, x), raw, common, per_turn)
        for x, inner in ((0, min(2, cols - 1)), (cols - 1, max(cols - 3, 0))):
            special[x] |= _dimmer((y, x), (y, inner), raw, common, per_turn)
        if shift.size > 1:
            _entry_line(coord[y], window, k, (numbers.usual, jump, footprint), most, at)
            _corrected_line(coord[y], variance[y], at, (shift, tables.unsure), out[y], sigma[y])
        else:
            _copied(coord[y], variance[y], out[y], sigma[y])
        if large:
            _with_ends(offset[y], light)
            lights = light, offset[max(y - 2, 0)], offset[min(y + 2, rows - 1)]
            inner, reach2, dark = REACH <= y < rows - REACH, reach * reach, numbers.dark
            stripe, lens, unsure = numbers.stripe, numbers.lens, numbers.lens_sigma
            limits = CentreLimits(
                jump, stripe, per_turn, reach2, border, dark, inner, lens, unsure, footprint
            )
            centred(coord[y], window, k, lights, limits, out[y], sigma[y])
        if large & (ends > 0):
            first = min(up, rows - 3)
            lights = amplitude[y], amplitude[first], amplitude[first + 2]
            faded(window, k, REACH, lights, ends, sigma[y])
        for x in places[: marked(special, places)]:
            flag, lost, bends = _neighbours(y, x, coord, variance, flags, amplitude, (jump, per_turn))
            here, c = window[k, x + REACH], x + REACH
            across = window[k, c - 2], window[k, c - 1], here, window[k, c + 1], window[k, c + 2]
            down = window[k - 2, c], window[k - 1, c], here, window[k + 1, c], window[k + 2, c]
            gx, gy = _step_on_a_map(across, jump), _step_on_a_map(down, jump)
            # curvature inside half a turn or more is unknown unless all neighbours are good
            four = across[1] + across[3] + down[1] + down[3]
            untold = four != four
            unknown = untold & ((gx + gy) * per_turn > np.float32(0.5))
            unknown |= _undersampled(across, per_turn) | _undersampled(down, per_turn)
            flag |= np.uint16(_OUTLIER if unknown else 0)
            low = here + here < extent - np.float32(1)
            inner_x, inner_y = _step_inwards(across, low, jump), _step_inwards(down, low, jump)
            off, shift_in, unsure_in = inwards(
                here,
                variance[y, x],
                footprint * inner_x,
                footprint * inner_y,
                reach,
                tables.border,
                extent,
            )
            out[y, x] -= shift_in
            # next to a flagged pixel the curvature is not subtracted (see centre)
            sigma[y, x] += lost + unsure_in + (bends if untold & large else np.float32(0))
            out_flags[y, x] |= flag | np.uint16(_OFF if off else 0)
        _root(sigma[y], numbers.roughness, numbers.least)


@kernel
def despeckle(start: int, stop: int, flags: U16, out: U16) -> None:
    """Rows start..stop of flags (H, W): a good pixel with fewer than three good neighbours of eight passed
    the checks by chance: OUTLIER. Pixels beyond the image count as the nearest inside, so that a corner has
    three."""
    (rows, cols), outlier = flags.shape, np.uint16(_OUTLIER)
    enough = np.uint8(4 if min(rows, cols) > 2 else 0)
    good = np.empty(cols + 2, np.uint8)
    for y in range(start, stop):
        up, here, down = flags[max(y - 1, 0)], flags[y], flags[min(y + 1, rows - 1)]
        for x in range(cols):
            good[x + 1] = np.uint8(up[x] == 0) + np.uint8(here[x] == 0) + np.uint8(down[x] == 0)
        good[0], good[cols + 1] = good[1], good[cols]
        for x in range(cols):
            lone = (here[x] == 0) & (np.uint8(good[x] + good[x + 1] + good[x + 2]) < enough)
            out[y, x] = here[x] | (outlier if lone else np.uint16(0))


@kernel
def _with_ends(line: F32, out: F32) -> None:
    """A line (W,) with each of its ends repeated twice, (W + 4,)."""
    for x in range(line.size):
        out[x + 2] = line[x]
    out[0] = out[1] = line[0]
    out[line.size + 2] = out[line.size + 3] = line[line.size - 1]


@exact
def _step_on_a_map(five: Five, jump: np.float32) -> np.float32:
    """Change per pixel from both neighbours; from the nearer one in value where their second difference
    exceeds a map's (the other is beyond an edge) or one is flagged; 0 from none."""
    _, before, here, after, _ = five
    least = lesser(here - before, after - here)
    return np.float32(0.5) * abs(after - before) if abs(before + after - here - here) <= jump else least


@exact
def _step_inwards(five: Five, low: bool, jump: np.float32) -> np.float32:
    """Change per pixel between the next two neighbours inwards of the nearer border (low: of the low
    coordinates), because at the border neighbours read nearly the same place; at an edge, see
    _step_on_a_map."""
    before_2, before, here, after, after_2 = five
    ahead = (after > here) == low if after == after else (before > here) != low
    near, next_ = (after, after_2) if ahead else (before, before_2)
    beside = _step_on_a_map(five, jump)
    return abs(next_ - near) if abs(here + next_ - near - near) <= jump else beside


@kernel
def _root(sigma: F32, roughness: np.float32, least: np.float32) -> None:
    for x in range(sigma.size):
        sigma[x] = max(np.sqrt(sigma[x] + roughness), least)


@kernel
def _special_line(window: F32, k: int, own: Own, limits: Limits, special: U8) -> None:
    """Mark good pixels that need the checks of _neighbours or of the border. own: flags of the line,
    variances of it and of the lines above and below."""
    (flags, var, var_above, var_below), size, four = own, special.size, np.float32(4)
    line, above, below = window[k, REACH:], window[k - 1, REACH:], window[k + 1, REACH:]
    for x in range(1, max(size - 1, 1)):
        cross = line[x], line[x - 1], line[x + 1], above[x], below[x]
        noise = var[x - 1] + four * var[x] + var[x + 1], var_above[x] + four * var[x] + var_below[x]
        special[x] = np.uint8(_tell(cross, noise, limits) & (flags[x] == 0))
    for x in (0, size - 1):
        cross = line[x], window[k, REACH + x - 1], line[x + 1], above[x], below[x]
        noise = np.float32(6) * var[x], var_above[x] + four * var[x] + var_below[x]
        special[x] = np.uint8(_tell(cross, noise, limits) & (flags[x] == 0))


@inlined
def _tell(cross: Five, noise: tuple[np.float32, np.float32], limits: Limits) -> bool:
    """Whether a pixel needs the checks of its neighbours or of the border. cross: the pixel and its
    neighbours in -x, +x, -y, +y; noise: variances of both second differences."""
    (c, left, right, up, down), (noise_x, noise_y), (jump, per_turn, reach2, border) = cross, noise, limits
    two, half, square = np.float32(2), np.float32(0.5), jump * jump
    # without a surface there is no border
    low = half if border < np.float32(np.inf) else border
    half_a_turn = half / max(per_turn, np.float32(1e-9))
    off_x, off_y = left + right - two * c, up + down - two * c
    bend_x, bend_y = off_x * off_x > _SURE2 * noise_x, off_y * off_y > _SURE2 * noise_y
    wide = (bend_x & (off_x * off_x > square)) | (bend_y & (off_y * off_y > square)) | (bend_x & bend_y)
    far = max(max(abs(c - left), abs(right - c)), max(abs(c - up), abs(down - c)))
    away = max(min(c + low, border - half - c), np.float32(0))
    footprint2 = ((right - left) * (right - left) + (down - up) * (down - up)) * np.float32(1 / 48)
    beside = off_x + off_y != off_x + off_y  # a flagged one
    return bool(wide | beside | (away * away <= SHADOW2 * (reach2 + footprint2)) | (far > half_a_turn))


@exact
def _dimmer(
    at: tuple[int, int], inner: tuple[int, int], raw: Raw, common: Common, per_turn: np.float32
) -> np.uint8:
    """Whether a good pixel at the image's edge has significantly less light than the one two pixels inwards,
    with a relevant shift: a place moves by half of the lost share."""
    (coord, variance), (flags, amplitude, _) = raw, common
    share = max(np.float32(1) - amplitude[at] / max(amplitude[inner], np.float32(1e-6)), np.float32(0))
    noise = np.float32(2) * _TURN2 * per_turn * per_turn * variance[at]
    shift = np.float32(0.25) * share * (coord[inner] - coord[at])
    counts = shift * shift > np.float32(SLIGHT**2) * variance[at]
    return np.uint8((flags[at] == 0) & counts & (share * share > _BULK2 * noise))


@kernel
def _entry_line(c: F32, window: F32, k: int, limits: Footprint, most: np.float32, at: U32) -> None:
    """Entries of a Pixelation by place in the cell and width of the footprint, `most` steps at most. limits:
    least footprint where both neighbours along rows or columns are flagged, largest second difference of a
    map, side of a pixel over its pitch."""
    half, places, (usual, jump, footprint) = np.float32(0.5), np.float32(PLACES), limits
    size = c.size
    left, right = window[k, :size], window[k, 2 * REACH : 2 * REACH + size]
    above, below = window[k - REACH, REACH : REACH + size], window[k + REACH, REACH : REACH + size]
    before, after = window[k, REACH - 1 : REACH - 1 + size], window[k, REACH + 1 : REACH + 1 + size]
    up, down = window[k - 1, REACH : REACH + size], window[k + 1, REACH : REACH + size]
    for x in range(size):
        gx = _broad_slope((left[x], before[x], c[x], after[x], right[x]), jump)
        gy = _broad_slope((above[x], up[x], c[x], down[x], below[x]), jump)
        alone = ((left[x] != left[x]) & (right[x] != right[x])) | (
            (above[x] != above[x]) & (below[x] != below[x])
        )
        width = footprint * np.sqrt(gx * gx + gy * gy)
        width = max(width, usual if alone else np.float32(0)) * places + half
        width = width if width < most else most
        place = np.int32((c[x] - np.floor(c[x])) * places + half) & np.int32(PLACES - 1)
        at[x] = np.uint32(np.int32(width)) * np.uint32(PLACES) + np.uint32(place)


@inlined
def _broad_slope(five: Five, jump: np.float32) -> np.float32:
    """Change per pixel from both neighbours REACH pixels away. Where their second difference exceeds a map's,
    one may be beyond an edge: then from the one that agrees with the nearest neighbours."""
    far_before, before, here, after, far_after = five
    one, two, per_step = np.float32(1), np.float32(2), np.float32(1 / REACH)
    back, ahead = (here - far_before) * per_step, (far_after - here) * per_step
    near = slope(before, here, after, one)
    side = back if abs(back - near) < abs(ahead - near) else ahead
    apart = abs(far_before + far_after - two * here) > jump
    return side if apart else slope(far_before, here, far_after, per_step)


@kernel
def _corrected_line(c: F32, var: F32, at: U32, tables: tuple[F32, F32], out: F32, total: F32) -> None:
    """Subtract pixelation from a line; add its variance."""
    shifts, doubts = tables
    for x in range(c.size):
        out[x] = c[x] + shifts[at[x]]
        total[x] = var[x] + doubts[at[x]]


@kernel
def _copied(c: F32, var: F32, out: F32, total: F32) -> None:
    for x in range(c.size):
        out[x] = c[x]
        total[x] = var[x]


class _Pixel(NamedTuple):
    """Pixel record, with the image's border repeated beyond it: whether it is inside the image, whether it is
    good; place, variance, amplitude."""

    inside: bool
    good: bool
    place: np.float32
    variance: np.float32
    amplitude: np.float32


@exact
def _pixel(y: int, x: int, coord: F32, variance: F32, flags: U16, amplitude: F32) -> _Pixel:
    i, j = min(max(y, 0), coord.shape[0] - 1), min(max(x, 0), coord.shape[1] - 1)
    inside = (i == y) & (j == x)
    return _Pixel(inside, inside & (flags[i, j] == 0), coord[i, j], variance[i, j], amplitude[i, j])


@exact
def _neighbours(
    y: int,
    x: int,
    coord: F32,
    variance: F32,
    flags: U16,
    amplitude: F32,
    limits: tuple[np.float32, np.float32],
) -> tuple[np.uint16, np.float32, np.float32]:
    """Flag of a good pixel and squared shift of its centre, from its good neighbours; squared shift by the
    map's curvature."""
    here = _pixel(y, x, coord, variance, flags, amplitude)
    left = _pixel(y, x - 1, coord, variance, flags, amplitude)
    right = _pixel(y, x + 1, coord, variance, flags, amplitude)
    up = _pixel(y - 1, x, coord, variance, flags, amplitude)
    down = _pixel(y + 1, x, coord, variance, flags, amplitude)
    left_2 = _pixel(y, x - 2, coord, variance, flags, amplitude)
    right_2 = _pixel(y, x + 2, coord, variance, flags, amplitude)
    up_2 = _pixel(y - 2, x, coord, variance, flags, amplitude)
    down_2 = _pixel(y + 2, x, coord, variance, flags, amplitude)
    beside, torn, lost_x, bend_x = _along((left_2, left, here, right, right_2), limits[0])
    others, torn_y, lost_y, bend_y = _along((up_2, up, here, down, down_2), limits[0])
    # without a neighbour on an axis, the centre of the remaining light is unknown
    brightest = max(max(left.amplitude, right.amplitude), max(up.amplitude, down.amplitude))
    dim = (limits[1] > 0) | (here.amplitude < np.float32(0.5) * brightest)
    alone = (beside + others <= 1) | ((beside * others == 0) & dim)
    alone &= (coord.shape[0] > 2) & (coord.shape[1] > 2)
    outlier = alone | torn | torn_y
    return np.uint16(_OUTLIER if outlier else 0), lost_x + lost_y, (bend_x + bend_y) * _BEND


@exact
def _along(
    five: tuple[_Pixel, _Pixel, _Pixel, _Pixel, _Pixel], jump: np.float32
) -> tuple[int, bool, np.float32, np.float32]:
    """Consistency along one axis: number of good neighbours (beyond the image: counted as good); whether the
    pixel contradicts both sides; squared shift of its centre; squared second difference beyond noise, or its
    upper bound where neither side has two good pixels."""
    before_2, before, here, after, after_2 = five
    none = np.float32(0)
    back, back_noise = _off_line(here, before, before_2)
    ahead, ahead_noise = _off_line(here, after, after_2)
    count = int(before.good or not before.inside) + int(after.good or not after.inside)
    inside = before.inside and after.inside
    if count < 2 or not inside:  # the mirror may end in a pixel at the image's edge
        near, next_ = (before, before_2) if before.good else (after, after_2)
        lost = none
        if near.good:  # the pixel two away has the same colour of a mosaic
            whole = max(next_.amplitude if next_.good else near.amplitude, np.float32(1e-6))
            share = max(np.float32(1) - here.amplitude / whole, none)
            lost = np.float32(0.5) * share * (here.place - near.place)
        bend = max(back - _BULK2 * back_noise, ahead - _BULK2 * ahead_noise, none)
        if max(back_noise, ahead_noise) == 0 and (before_2.inside or after_2.inside):
            if inside:
                bend = _untold(before, here, after, jump)
            elif after.inside:
                bend = _untold(here, after, after_2, jump)
            else:
                bend = _untold(before_2, before, here, jump)
        return count, False, lost * lost, bend
    off = before.place + after.place - np.float32(2) * here.place
    noise = before.variance + np.float32(4) * here.variance + after.variance
    bend, lost = max(min(off * off, np.float32(4) * jump * jump) - _BULK2 * noise, none), none
    if off * off > max(jump * jump, _SURE2 * noise):
        fits_back, fits_ahead = back < _SURE2 * back_noise, ahead < _SURE2 * ahead_noise
        if not (fits_back or fits_ahead):
            return count, True, none, none
        lost = min(back if fits_back else ahead, ahead if fits_ahead else back) + bend * _BEND
    return count, False, lost, bend


@exact
def _untold(before: _Pixel, here: _Pixel, after: _Pixel, jump: np.float32) -> np.float32:
    """Upper bound of the squared second difference where some of three pixels are flagged: its estimate plus
    noise, limited to a map's largest."""
    off = before.place + after.place - np.float32(2) * here.place
    noise = before.variance + np.float32(4) * here.variance + after.variance
    return min(np.float32(4) * jump * jump, off * off + noise)


@exact
def _off_line(here: _Pixel, near: _Pixel, next_: _Pixel) -> tuple[np.float32, np.float32]:
    """Squared distance from the line through the next two pixels on one side, and its variance; from a single
    neighbour without noise; 0 from none."""
    off = near.place - here.place - (next_.place - near.place if next_.good else np.float32(0))
    noise = here.variance + np.float32(4) * near.variance + next_.variance
    return (off * off if near.good else np.float32(0)), (noise if near.good & next_.good else np.float32(0))


@exact
def _undersampled(five: Five, per_turn: np.float32) -> bool:
    """Whether the fringe order at the middle of five pixels is ambiguous. Either more than half a turn of the
    finest fringe lies between it and each neighbour, and the steps differ by a quarter of a turn (or are
    unknown); or a pixel takes nearly a turn: its contrast vanishes, and is reversed beyond.
    """
    a, b, c, d, e = five
    one, two = abs(b - a) * per_turn, abs(c - b) * per_turn
    three, four = abs(d - c) * per_turn, abs(e - d) * per_turn
    uneven = max(max(one, four), max(two, three)) - min(min(one, four), min(two, three))
    unknown = one + two + three + four != one + two + three + four
    tells = unknown | (uneven > np.float32(0.25)) | (two + three > np.float32(2 * STEEP))
    return bool((min(two, three) > np.float32(0.5)) & tells)
