"""decode(): frames and their descriptions -> Correspondence."""

from dataclasses import dataclass, replace
from functools import reduce
from threading import local

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.blocks import over_rows
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.patterns import Sequence

from .axis import AxisDecoder, axis_decoder
from .correspondence import Correspondence, Flag
from .display import measured_pixelations
from .exposures import better_of, by_exposure
from .flags import Shared, merge
from .frames import Light, light_of
from .integrity import examine, spoilt_pixels
from .noise import Noise, Sample, estimate_noise
from .plan import Plan, plan
from .response import Response
from .spatial import Raw, check_rows

__all__ = ["decode"]

#: Rows of a block that a thread takes: what it keeps of them fits the second-level cache.
_BLOCK = 16
#: Sigma that is stated for frames without noise beyond their rounding, pattern pixels.
_LEAST_SIGMA = 0.01
Mask = NDArray[np.bool_]


def decode(
    frames: ArrayLike,
    sequence: Sequence,
    *,
    noise: float | None = None,
    gain: float = 0.0,
    white_level: float | None = None,
    response: Response | None = None,
    blur_px: float | None = None,
    on_cells: bool = True,
    subpixel: bool = False,
    mask: ArrayLike | None = None,
    check: bool = True,
) -> Correspondence:
    """Where on the pattern every camera pixel looks.

    frames       (N, H, W) uint8 or uint16 (floats are taken, too), frame i as sequence.frames[i] describes it
    noise, gain  of the camera: variance = noise^2 + gain * level, levels of the frames before rounding;
                 without `noise` both are estimated from the frames
    white_level  level at which the camera clips; default 255, for uint16 the 10, 12, 14 or 16 bits in use
    response     camera level against shown level, inverted first
    blur_px      rms blur between display and camera, cells; default: estimated (see display)
    on_cells     frames were shown on the cells of a surface of the sequence's size, as Frame.tables says,
                 dark around it; what that shifts is taken off (see display). False: ideal cosines
    subpixel     binary codes: answers within their cells, from the blur of their edges, where it tells
    mask         (H, W) bool: pixels to decode, the others are INVALID
    check        look for frames that are not those described (see integrity): a notice names them, what can do
                 without them is decoded without them, else the pixels that they could have spoilt are flagged

    A code under several exposures is decoded from each that shows all of it, every pixel from its best one:
    amplitude and offset are levels of that exposure. InputError if frames and sequence do not fit or hold
    values that are not finite.
    """
    light = light_of(frames, sequence, white_level, response)
    inside = _mask(mask, light.raw.shape[1:])
    options = _Options(_given_noise(noise, gain, light), blur_px, on_cells, subpixel, inside, check)
    parts = by_exposure(sequence)
    return reduce(better_of, (_decoded(_part(light, part.index), part.sequence, options) for part in parts))


@dataclass(frozen=True, slots=True)
class _Options:
    noise: Noise | None
    blur: float | None
    on_cells: bool
    subpixel: bool
    mask: Mask | None
    check: bool


def _mask(mask: ArrayLike | None, shape: tuple[int, ...]) -> Mask | None:
    if mask is None:
        return None
    inside = np.asarray(mask)
    if inside.shape != shape or inside.dtype != np.bool_:
        raise InputError(f"decode: mask is {inside.dtype} {inside.shape}, must be bool {shape}")
    return inside


def _given_noise(noise: float | None, gain: float, light: Light) -> Noise | None:
    for name, value in (("noise", noise), ("gain", gain)):
        if value is not None and not 0 <= value < np.inf:
            raise InputError(f"decode: {name} is {value}, must be finite and at least 0")
    return None if noise is None else Noise(max(noise**2 + light.rounding, 1e-12), gain)


def _part(light: Light, index: NDArray[np.int64]) -> Light:
    if len(index) == len(light.raw):
        return light
    return Light(np.ascontiguousarray(light.raw[index]), light.clip, light.table, light.rounding)


def _decoded(light: Light, sequence: Sequence, options: _Options) -> Correspondence:
    """The six steps, for frames of one exposure."""
    wanted = plan(sequence)
    noise, lit = _noise(light, wanted, options)
    decoders = [
        axis_decoder(axis, sequence, wanted, light, noise, lit, options.on_cells) for axis in wanted.axes
    ]
    raw, shared = _estimated(light, noise, decoders)
    found = _among_neighbours(decoders, lit, raw, shared, options, sequence, noise)
    if options.mask is not None:
        np.bitwise_or(found.flags, np.uint16(Flag.INVALID), out=found.flags, where=~options.mask)
    return _checked(light, sequence, wanted, noise, lit, found, options) if options.check else found


def _checked(
    light: Light,
    sequence: Sequence,
    wanted: Plan,
    noise: Noise,
    lit: Sample,
    found: Correspondence,
    options: _Options,
) -> Correspondence:
    """Without the frames that are not those described, or with what they could have spoilt flagged."""
    findings = examine(light, wanted, noise, lit, found)
    told = tuple(Notice(one.sentence, one.share, float("nan"), one.cure) for one in findings)
    for finding in findings:
        if finding.leave_out:
            index = np.array([i for i in range(len(sequence)) if i not in finding.leave_out])
            less = replace(sequence, frames=tuple(sequence.frames[i] for i in index))
            found = _decoded(_part(light, index), less, replace(options, check=False))
        else:
            spoilt = spoilt_pixels(finding, light, wanted, noise, found)
            np.bitwise_or(found.flags, np.uint16(Flag.WRONG_FRAME), out=found.flags, where=spoilt)
    return replace(found, notices=found.notices + told)


def _noise(light: Light, wanted: Plan, options: _Options) -> tuple[Noise, Sample]:
    noise, lit = estimate_noise(light, wanted, options.mask)
    return (noise if options.noise is None else options.noise), lit


def _estimated(light: Light, noise: Noise, decoders: list[AxisDecoder]) -> tuple[dict[str, Raw], Shared]:
    """Every axis, block by block of rows."""
    shape = light.raw.shape[1:]
    raw = {
        decoder.axis.axis: Raw(np.empty(shape, np.float32), np.empty(shape, np.float32))
        for decoder in decoders
    }
    shared = Shared(np.empty(shape, np.uint16), *(np.empty(shape, np.float32) for _ in range(3)))
    room = local()

    def block(start: int, stop: int) -> None:
        for i, decoder in enumerate(decoders):
            own = raw[decoder.axis.axis]
            estimate = decoder.estimate((start, stop), own, room)
            merge(estimate, noise, decoder.limits, i == 0, (start, stop), shared)

    over_rows(block, shape[0], _BLOCK)
    return raw, shared


def _among_neighbours(
    decoders: list[AxisDecoder],
    lit: Sample,
    raw: dict[str, Raw],
    shared: Shared,
    options: _Options,
    sequence: Sequence,
    noise: Noise,
) -> Correspondence:
    """Pixelation taken off, edges and strays flagged."""
    shape = shared.flags.shape
    silent = bool(noise.variance(float(lit.levels.mean()) if lit.levels.size else 0.0) < 1.5 / 12)
    least = _LEAST_SIGMA if silent else 0.0
    cells = options.on_cells and not sequence.nominal
    maps = tuple((one.coordinate, one.variance) for one in raw.values())
    axes = tuple(decoder.axis for decoder in decoders)
    pixelations = measured_pixelations(axes, maps, cells, options.blur, lit)
    out = {axis: [np.full(shape, fill, np.float32) for fill in (np.nan, np.inf)] for axis in "uv"}
    flags = shared.flags.copy()

    def block(start: int, stop: int) -> None:
        for decoder, pixelation in zip(decoders, pixelations, strict=True):
            name = decoder.axis.axis
            extent = float(decoder.axis.extent) if cells else 0.0
            check_rows(
                (start, stop),
                raw[name],
                (shared.flags, shared.amplitude),
                pixelation,
                (extent, decoder.jump, least),
                (*out[name], flags),
            )

    over_rows(block, shape[0], _BLOCK)
    (u, sigma_u), (v, sigma_v) = out["u"], out["v"]
    common = shared.amplitude, shared.offset, shared.error
    rough = max(pixelation.roughness**0.5 for pixelation in pixelations)
    return Correspondence(u, v, sigma_u, sigma_v, flags, *common, _unlike(noise, rough))


def _unlike(noise: Noise, rough: float) -> tuple[Notice, ...]:
    """What frames or neighbours show beyond noise."""
    cure = (
        "the response (gamma), flicker, a slow display or stray light; sigma holds what neighbours show of it"
    )
    told = []
    if noise.misfit2 > 0:
        share = float(np.sqrt(noise.misfit2))
        told.append(Notice("frames contradict each other, share of the amplitude", share, 0.0, cure))
    if rough > 0:
        told.append(Notice("neighbours differ beyond noise, pattern px rms", rough, 0.0, cure))
    return tuple(told)
