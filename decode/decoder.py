"""decode(): frames and their descriptions -> Correspondence."""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.blocks import over_rows
from optolever.errors import InputError
from optolever.memory import roomy_empty
from optolever.notices import Notice
from optolever.patterns import Sequence
from optolever.records import LOG, Progress, logged, silent

from .axis import AxisDecoder, AxisOptions, Shot, axis_decoders
from .centre import dark_level
from .checks.integrity import examine, spoilt_pixels
from .correspondence import Correspondence, Flag
from .display import rounded_places, shares_of, take_off
from .exposures import Part, better_of, by_exposure
from .flags import Shared
from .float_frames import in_levels
from .frames import Light, light_of, sample_levels
from .plan import plan, raster_axes
from .profile.border import NO_BORDER, Border, border_of, measured_blur
from .profile.edge_lines import widen_edge_lines
from .profile.ends import end_width
from .profile.lens import measured_lens
from .profile.moved import Seen
from .profile.noise import Noise, Sample, estimate_noise, under_response
from .profile.pixelation import REACH, Pixelation, measured_pixelations, usual_width
from .profile.shared_noise import shared_noise
from .profile.unlike import Before, held_before, without_before
from .response import Response
from .spatial import Raw, check_rows, despeckle

__all__ = ["decode"]

#: Rows of a block that a thread takes: what it keeps of them fits the second-level cache.
_BLOCK = 32
#: Pixels of several rows that are read as one line, at most: to start a loop takes as long as some hundred.
_LINE = 1 << 13
#: Sigma that is stated for frames without noise beyond their rounding, pattern pixels.
_LEAST_SIGMA = 0.01
#: Notices of what no sequence says, and what to do.
_SLOW = (
    "frames hold a share of earlier ones",
    "a slow display: wait longer before each frame is captured; the share is taken off",
)
_HELD = (
    "some frames, or parts of them, hold a share of earlier ones",
    "a display that is not yet done when the camera exposes: wait longer; sigma holds it",
)
_BRIGHT = (
    "white saturates, share of the pixels; bits without inverses are compared with it",
    "a shorter exposure, or inverses: edges of bits are known if white is at most twice what can be read",
)
#: Share of the pixels that highlights may saturate.
_HIGHLIGHTS = 0.01
_CURE = "gamma, flicker, a slow display or stray light; sigma holds what frames and neighbours show of it"
_MISFIT = "frames contradict each other, share of the amplitude", _CURE
_ROUGH = "neighbours differ beyond noise, pattern px rms", _CURE


def decode(
    frames: ArrayLike,
    sequence: Sequence,
    *,
    noise: float | None = None,
    gain: float = 0.0,
    white_level: float | None = None,
    response: Response | None = None,
    blur_px: float | None = None,
    lens_px: float | None = None,
    on_cells: bool = True,
    subpixel: bool = False,
    mask: ArrayLike | None = None,
    check: bool = True,
    progress: Progress = silent,
) -> Correspondence:
    """Where on the pattern every camera pixel looks.

    frames       (N, H, W) uint8 or uint16 (floats of any unit are taken, too; pixels that are not finite are
                 INVALID), frame i as sequence.frames[i] describes it
    noise, gain  of the camera: variance = noise^2 + gain * level, levels of the frames before rounding;
                 without `noise` both are estimated from the frames
    white_level  level at which the camera clips; default 255, for uint16 the 10, 12, 14 or 16 bits in use
    response     camera level against shown level: a camera's is inverted first; of a display the light of the
                 shown levels is looked up (known cells and an exposure of 1; else it is inverted, too)
    blur_px      rms blur between display and camera, cells; default: estimated (see display)
    lens_px      rms blur of the camera's lens, its pixels (4 at most): what it flattens of the map's bends is
                 taken off; default: as fringes tell it (see lens), else 0 (a slanted edge does, ISO 12233)
    on_cells     frames were shown on the cells of a surface of the sequence's size, as Frame.tables says,
                 dark around it; what that shifts is taken off (see display). False: ideal cosines
    subpixel     binary codes: answers within their cells, from the blur of their edges, where it tells
    mask         (H, W) bool: pixels to decode, the others are INVALID
    check        look for frames that are not those described (see integrity): a notice names them, what can
                 do without them is decoded without them, else the pixels that they could have spoilt are
                 flagged
    progress     called with what is being done, how many steps are done, and of how many

    A code under several exposures is decoded from each that shows all of it, every pixel from its best one:
    amplitude and offset are levels of that exposure. InputError if frames and sequence do not fit.
    """
    levels = in_levels(frames)
    bent = None
    if response is not None and response.blur is not None and on_cells and _looks_up(sequence):
        if blur_px is None and not np.isnan(response.blur):
            blur_px = response.blur
        response, bent = None, response
    white = white_level and white_level * levels.unit
    light = light_of(levels.frames, sequence, white, response)
    options = _Options(
        _given_noise(noise and noise * levels.unit, gain * levels.unit, light),
        bent,
        blur_px,
        _lens2(lens_px),
        on_cells,
        subpixel,
        _mask(levels.inside(mask), light),
        check,
        progress,
    )
    raster_axes(sequence)  # of an exposure alone it may be whole
    parts = by_exposure(sequence)
    with logged(f"decode {light.raw.shape} by {sequence.name}"):
        found = levels.restored(reduce(better_of, (_decoded(light, part, options) for part in parts)))
    for notice in found.notices:
        LOG.warning("%s", notice)
    return found


@dataclass(frozen=True, slots=True)
class _Options:
    noise: Noise | None
    bent: Response | None
    blur: float | None
    lens2: float | None
    on_cells: bool
    subpixel: bool
    mask: NDArray[np.bool_] | None
    check: bool
    progress: Progress


def _decoded(light: Light, part: Part, options: _Options) -> Correspondence:
    """The steps: noise, each axis, flags, neighbours, integrity."""
    step, steps = options.progress, 3 + options.check
    step("noise", 0, steps)
    light = light.only(part.index)
    sequence = part.sequence if options.bent is None else options.bent.described(part.sequence)
    wanted = plan(sequence)
    noise, lit = estimate_noise(light, wanted, options.mask)
    given = options.noise
    before = held_before(wanted, lit) if light.response is None and options.bent is None else Before()
    if before.share:
        light, times = without_before(light, wanted, before), before.noisier
        noise, lit = estimate_noise(light, wanted, options.mask)
        given = given and replace(given, read2=given.read2 * times, gain=given.gain * times)
    light, noise, lit = under_response(light, given or noise, lit)
    cells = options.on_cells and not sequence.nominal
    shot = Shot(light, sequence, wanted, noise, lit, cells)
    chosen = AxisOptions(options.subpixel, options.noise is not None, options.blur, before)
    decoders = axis_decoders(shot, chosen)
    step("axes", 1, steps)
    raw, shared = _estimated(shot, decoders)
    if options.mask is not None:
        np.bitwise_or(shared.flags, np.uint16(Flag.INVALID), out=shared.flags, where=~options.mask)
    step("neighbours", 2, steps)
    found = _among_neighbours(shot, decoders, raw, shared, options)
    own = _noticed(_HELD, max(before.left.values(), default=0.0)) + _noticed(_BRIGHT, _too_bright(shot))
    found = replace(found, notices=own + found.notices)
    if options.check:
        step("frames", 3, steps)
        found = _checked(shot, part, found, options)
    step("decoded", steps, steps)
    return replace(found, notices=_noticed(_SLOW, before.share) + found.notices)


def _estimated(shot: Shot, decoders: list[AxisDecoder]) -> tuple[list[Raw], Shared]:
    """Every axis, block by block of rows; flags of both."""
    shape = rows, cols = shot.light.raw.shape[1:]
    raw = [Raw(*(roomy_empty(shape, np.float32) for _ in range(2))) for _ in decoders]
    shared = Shared(roomy_empty(shape, np.uint16), *(roomy_empty(shape, np.float32) for _ in range(3)))
    # but for look-ups, which go from pixel to pixel along a row
    most = 1 if any(decoder.table is not None for decoder in decoders) else max(_LINE // cols, 1)
    count = next(n for n in (16, 8, 4, 2, 1) if n <= most and rows % n == 0)
    lines = rows // count, cols * count
    of_axes = [Raw(*(one.reshape(lines) for one in own)) for own in raw]
    of_both = Shared(*(one.reshape(lines) for one in shared))
    longer = [
        replace(one, light=replace(one.light, raw=one.light.raw.reshape(-1, *lines))) for one in decoders
    ]

    def block(start: int, stop: int) -> None:
        for i, (decoder, own) in enumerate(zip(longer, of_axes, strict=True)):
            decoder.decode((start, stop), own, i == 0, of_both)

    over_rows(block, lines[0], max(_BLOCK // count, 1))
    return raw, shared


def _without_rounding(shot: Shot, name: str, coord: NDArray[np.float32], width: float) -> None:
    """What rounded grey values shift taken off the coordinates of an axis; width: of pixels, cells."""
    table = rounded_places(name, shot.sequence, width)
    over_rows(lambda start, stop: take_off(coord[start:stop], table), len(coord), _BLOCK)


def _among_neighbours(
    shot: Shot, decoders: list[AxisDecoder], raw: list[Raw], shared: Shared, options: _Options
) -> Correspondence:
    """Pixelation taken off; edges, strays and partial footprints flagged or in sigma."""
    shape = shared.flags.shape
    widths = [usual_width(shot.lit, own.coordinate, shared.flags) for own in raw]
    for decoder, own, width in zip(decoders, raw, widths, strict=True):
        if shot.cells and decoder.periods is not None:
            _without_rounding(shot, decoder.axis.axis, own.coordinate, width)
    shown = replace(shot.plan, axes=tuple(decoder.axis for decoder in decoders))
    maps = tuple((one.coordinate, one.variance) for one in raw)
    pixelations = measured_pixelations(shown, maps, shot.cells, options.blur, shot.lit)
    borders = _borders(shot, decoders, raw, shared, pixelations) if shot.cells else [NO_BORDER] * len(raw)
    tables, roughness = [one.tables() for one in pixelations], [one.roughness for one in pixelations]
    least = _LEAST_SIGMA if _silent(shot) else 0.0
    end, dark = end_width(shared.amplitude, shared.flags), _dark_level(shot.lit, shared)
    lens2 = options.lens2
    if lens2 is None:
        lens2 = measured_lens(shown, shot.lit, [own.coordinate for own in raw], shared.flags)
    out = {axis: (roomy_empty(shape, np.float32), roomy_empty(shape, np.float32)) for axis in "uv"}
    for axis in set("uv") - {decoder.axis.axis for decoder in decoders}:
        out[axis][0][:], out[axis][1][:] = np.nan, np.inf
    flags = roomy_empty(shape, np.uint16)

    def block(start: int, stop: int) -> None:
        flags[start:stop] = shared.flags[start:stop]
        every = zip(decoders, raw, widths, tables, roughness, borders, strict=True)
        for decoder, own, width, table, rough, border in every:
            extent = float(decoder.axis.extent) if shot.cells else 0.0
            finest = decoder.jump, decoder.stripe, decoder.per_turn
            limits = border.reach, rough, extent, *finest, least, end, dark, width, lens2
            common = shared.flags, shared.amplitude, shared.offset
            maps = (*out[decoder.axis.axis], flags)
            check_rows((start, stop), own, common, (*table, border.table), limits, maps)

    over_rows(block, shape[0], _BLOCK)
    over_rows(lambda start, stop: despeckle(start, stop, flags, shared.flags), shape[0], _BLOCK)
    widen_edge_lines([out[decoder.axis.axis] for decoder in decoders], shared.flags)
    misfits = [one.table.misfit2 for one in decoders if one.table is not None]
    misfits += [2 * (2 * np.pi) ** 2 * one.between for one in decoders]  # of a sample, as phases have it
    notices = _noticed(_MISFIT, max(shot.noise.misfit2, *misfits, 0.0) ** 0.5)
    notices += _noticed(_ROUGH, max(roughness) ** 0.5)
    (u, sigma_u), (v, sigma_v) = out["u"], out["v"]
    common = shared.amplitude, shared.offset, shared.error
    left = {
        decoder.axis.axis: one.in_common(width, shot.lit, *own, shared.flags)
        for decoder, own, one, width in zip(decoders, raw, pixelations, widths, strict=True)
    }
    in_common = shared_noise(shown, shot.lit, _seen(shot, decoders, raw, shared.flags, widths), left)
    return Correspondence(u, v, sigma_u, sigma_v, shared.flags, *common, notices, in_common)


def _seen(
    shot: Shot, decoders: list[AxisDecoder], raw: list[Raw], flags: NDArray[np.uint16], widths: list[float]
) -> dict[str, Seen]:
    """Places of the sampled pixels, of each axis, as far as they are good."""
    at, found = tuple(shot.lit.places.T), {}
    for decoder, own, width in zip(decoders, raw, widths, strict=True):
        place = np.where(flags[at] == 0, own.coordinate[at], np.float32(np.nan))
        spread = 0.0 if decoder.table is None else decoder.table.optics.with_cell
        found[decoder.axis.axis] = Seen(place, width if shot.cells else None, spread)
    return found


def _dark_level(lit: Sample, shared: Shared) -> float:
    """By the sampled pixels that are good so far."""
    level, amplitude, flags = (
        one[tuple(lit.places.T)] for one in (shared.offset, shared.amplitude, shared.flags)
    )
    return dark_level(level[flags == 0], amplitude[flags == 0])


def _borders(
    shot: Shot, decoders: list[AxisDecoder], raw: list[Raw], shared: Shared, pixelations: list[Pixelation]
) -> list[Border]:
    """Of each axis, by the blur that either border tells, or else by one that bounds it."""
    shares = [() if one.table is not None else shares_of(one.axis) for one in decoders]
    told = [
        measured_blur(own.coordinate, shared.flags, (shared.offset, shared.amplitude), one.axis.extent, share)
        for own, one, share in zip(raw, decoders, shares, strict=True)
    ]
    blurs, count = max(told, key=lambda one: one[1])
    if count:
        return [border_of(share, blurs) for share in shares]
    tables = [decoder.table for decoder in decoders]
    measured = zip(shares, tables, pixelations, strict=True)
    bounds = [(share, one.bound if table is None else table.optics.reach) for share, table, one in measured]
    return [border_of(share, (bound,) * 3, False) for share, bound in bounds]


def _checked(shot: Shot, part: Part, found: Correspondence, options: _Options) -> Correspondence:
    """Without the frames that are not those described, or with what they could have spoilt flagged."""
    sequence, light, lit = part.sequence, shot.light, shot.lit
    wanted = plan(sequence)
    if options.bent is not None and light.raw.dtype.kind == "u":  # to tell frames apart, inverted ones do
        light = light_of(light.raw, sequence, light.clip, options.bent)
        lit = replace(lit, levels=sample_levels(light, lit.places), white=light.white)
    findings = examine(light, wanted, lit, found, part.index)
    told = tuple(Notice(one.sentence, one.share, float("nan"), one.cure) for one in findings)
    for finding in findings:
        if finding.leave_out:
            index = np.array([i for i in range(len(sequence)) if i not in finding.leave_out])
            less = replace(sequence, frames=tuple(sequence.frames[i] for i in index))
            found = _decoded(shot.light, Part(index, less), replace(options, check=False, progress=silent))
        else:
            spoilt = spoilt_pixels(finding, light, wanted, shot.noise, found)
            np.bitwise_or(found.flags, np.uint16(Flag.WRONG_FRAME), out=found.flags, where=spoilt)
    return replace(found, notices=found.notices + told)


def _looks_up(sequence: Sequence) -> bool:
    """Whether the light of the levels is known of every place: cells and exposures are."""
    return not sequence.nominal and all(frame.exposure == 1 for frame in sequence.frames)


def _noticed(what: tuple[str, str], size: float) -> tuple[Notice, ...]:
    """A notice of what frames or neighbours show beyond noise, if they do."""
    return (Notice(what[0], size, 0.0, what[1]),) if size else ()


def _too_bright(shot: Shot) -> float:
    """Share of the pixels in which white saturates, where bits are compared with it; 0 if these may be
    highlights."""
    codes = [axis.code for axis in shot.plan.axes if axis.code is not None]
    single = any((np.minimum(code.plain, code.inverse) < 0).any() for code in codes)
    if not single or shot.plan.white < 0 or not shot.lit.levels.size:
        return 0.0
    share = float((shot.lit.levels[shot.plan.white] >= shot.lit.white).mean())
    return share if share > _HIGHLIGHTS else 0.0


def _silent(shot: Shot) -> bool:
    """Whether there is no noise beyond rounding."""
    usual = float(shot.lit.levels.mean()) if shot.lit.levels.size else 0.0
    return bool(shot.noise.variance(usual) < 1.5 * (shot.light.rounding or 1 / 12))


def _mask(mask: ArrayLike | None, light: Light) -> NDArray[np.bool_] | None:
    if mask is None:
        return None
    inside, shape = np.asarray(mask), light.raw.shape[1:]
    if inside.shape != shape or inside.dtype != np.bool_:
        raise InputError(f"decode: mask is {inside.dtype} {inside.shape}, must be bool {shape}")
    return inside


def _lens2(blur: float | None) -> float | None:
    """Variance of a lens's blur, px^2."""
    if blur is None:
        return None
    if not 0 <= blur <= REACH:  # over so many pixels bends are told
        raise InputError(f"decode: lens_px is {blur}, must be 0 to {REACH}")
    return float(blur) ** 2


def _given_noise(noise: float | None, gain: float, light: Light) -> Noise | None:
    for name, value in (("noise", noise), ("gain", gain)):
        if value is not None and not 0 <= value < np.inf:
            raise InputError(f"decode: {name} is {value}, must be finite and at least 0")
    if noise is None:
        return None
    return Noise(max(noise**2 + light.rounding, 1e-12), gain, light.rounding)
