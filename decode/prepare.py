"""From frames of a rig to its profile: first a sample of pixels, then the decoded maps, then the result; and
from a profile to tables.

Here a setting's response is the display's: a camera's is already inverted in the frames' levels.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.notices import Notice
from optolever.patterns import Sequence

from .apply import (
    Maps,
    Prepared,
    Steps,
    border_shares,
    corrected,
    decoded_axes,
    neighbours,
    rounding_of,
    tables_of,
    with_profile,
)
from .axis import AxisDecoder, AxisOptions, Setup, Shot, axis_decoders, estimate_axes
from .centre import dark_level
from .checks.integrity import examine
from .checks.spoilt import Finding, spoilt_pixels
from .correspondence import Correspondence, Flag
from .exposures import Part
from .flags import Shared
from .frames import Light, light_of, sample_levels
from .plan import Plan, plan
from .profile.border import NO_BLUR, BorderBlur, measured_blur
from .profile.edge_lines import edge_lines
from .profile.ends import end_width
from .profile.lens import NO_LENS, Lens, measured_lens
from .profile.moved import Seen
from .profile.noise import Noise, Sample, estimate_noise, under_response
from .profile.pixelation import Pixelation, measured_pixelations, usual_width
from .profile.shared_noise import shared_noise
from .profile.unlike import Before, held_before, without_before
from .rig_profile import AxisProfile, ExposureProfile, Settings
from .sampled import NOTHING, sampled

__all__ = ["Estimated", "estimated", "prepared"]

#: Notices of deviations that a sequence does not describe, with the remedy.
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
    "a shorter exposure, or inverses: edges of bits are flagged or their cells wider",
)
#: Share of the pixels that highlights may saturate.
_HIGHLIGHTS = 0.01
_CURE = "gamma, flicker, a slow display or stray light; sigma holds what frames and neighbours show of it"
_STRAY = (
    "neighbours share an error, of the amplitude",
    "a second reflection (black the other faces), a camera that sharpens, a slow display; sigma holds it",
)
_MISFIT = "frames contradict each other, share of the amplitude", _CURE
_ROUGH = "neighbours differ beyond noise, pattern px rms", _CURE


class Estimated(NamedTuple):
    """Correspondence of the frames of one exposure, the prepared decoder, and findings of wrong frames: with
    any, the decoder holds for this capture only."""

    found: Correspondence
    prepared: Prepared
    findings: tuple[Finding, ...]


def _described(sequence: Sequence, settings: Settings) -> Sequence:
    """The sequence; with a display's response, by the light of its levels."""
    return sequence if settings.response is None else settings.response.described(sequence)


def estimated(light: Light, part: Part, settings: Settings, mask: NDArray[np.bool_] | None) -> Estimated:
    """First tests of the frames; then noise and axes from a sample; pixelation, border and lens from the
    maps; the rest from the result."""
    noise, lit = estimate_noise(light, plan(_described(part.sequence, settings)), mask)
    findings = _findings(light, part, noise, lit, settings) if settings.check else ()
    for finding in findings:
        if finding.leave_out or finding.put_back:
            less = _without(finding, part)
            rest = estimated(light.only(less.index), less, replace(settings, check=False), mask)
            found = replace(rest.found, notices=rest.found.notices + _named(findings))
            return rest._replace(found=found, findings=findings)
    shot, camera, lag = _shot(light, part, settings, mask, noise, lit)
    options = AxisOptions(settings.subpixel, settings.noise is not None, settings.blur_px, lag)
    numbers = estimate_axes(shot, options)
    steps = Steps(shot.setup, lag, axis_decoders(shot.setup, numbers), shot.light.spread, shot.light.steep)
    maps = decoded_axes(shot.light, steps, mask)
    profile = _from_maps(shot, camera, steps, maps, settings)
    done = Prepared(part, steps, tables_of(steps, profile, settings.footprint or 1.0), profile)
    found = neighbours(maps, done)
    profile = _from_result(shot, steps, maps, profile, found)
    found = with_profile(found, profile)
    for finding in findings:
        spoilt = spoilt_pixels(finding, shot.light, shot.setup.plan, shot.setup.noise, found)
        np.bitwise_or(found.flags, np.uint16(Flag.WRONG_FRAME), out=found.flags, where=spoilt)
    found = replace(found, notices=found.notices + _named(findings))
    return Estimated(found, replace(done, profile=profile), findings)


def _findings(light: Light, part: Part, noise: Noise, lit: Sample, settings: Settings) -> tuple[Finding, ...]:
    """Findings of wrong frames, by the camera's levels; light: of the part's frames."""
    if settings.response is not None and light.raw.dtype.kind == "u":  # tests need inverted levels
        light = light_of(light.raw, part.sequence, light.clip, settings.response)
        lit = replace(lit, levels=sample_levels(light, lit.places), white=light.white)
    return examine(light, plan(part.sequence), noise, lit, part.index)


def _without(finding: Finding, part: Part) -> Part:
    """The other frames, each with the image that shows it; index: among those of the part."""
    kept = [i for i in range(len(part.sequence)) if i not in finding.leave_out]
    images = finding.images or range(len(part.sequence))
    less = replace(part.sequence, frames=tuple(part.sequence.frames[i] for i in kept))
    return Part(np.array([images[i] for i in kept]), less)


def _named(findings: tuple[Finding, ...]) -> tuple[Notice, ...]:
    return tuple(Notice(one.sentence, one.share, float("nan"), one.cure) for one in findings)


def prepared(part: Part, settings: Settings, profile: ExposureProfile, light: Light) -> Prepared:
    """The decoder of a profile, for frames of this type."""
    sequence = _described(part.sequence, settings)
    cells = settings.on_cells and not sequence.nominal
    setup = Setup(sequence, plan(sequence), profile.noise, cells, profile.white)
    decoders = axis_decoders(setup, tuple(axis.numbers for axis in profile.axes))
    if light.response is not None:
        light = light.under(profile.camera.read2, profile.camera.gain)
    steps = Steps(setup, profile.lag, decoders, light.spread, light.steep)
    return Prepared(part, steps, tables_of(steps, profile, settings.footprint or 1.0), profile)


def _shot(
    light: Light,
    part: Part,
    settings: Settings,
    mask: NDArray[np.bool_] | None,
    noise: Noise,
    lit: Sample,
) -> tuple[Shot, Noise, Before]:
    """Frames without lag, with their noise and a sample of illuminated pixels; noise of the camera's raw
    levels; lag."""
    sequence = _described(part.sequence, settings)
    wanted = plan(sequence)
    given = _given_noise(settings, light)
    linear = light.response is None and sequence is part.sequence
    lag = held_before(wanted, lit) if linear else Before()
    if lag.share:
        light, times = without_before(light, wanted, lag), lag.noisier
        noise, lit = estimate_noise(light, wanted, mask)
        given = given and replace(given, read2=given.read2 * times, gain=given.gain * times)
    camera = given or noise
    light, noise, lit = under_response(light, camera, lit)
    cells = settings.on_cells and not sequence.nominal
    return Shot(Setup(sequence, wanted, noise, cells, light.white), light, lit), camera, lag


def _given_noise(settings: Settings, light: Light) -> Noise | None:
    if settings.noise is None:
        return None
    return Noise(max(settings.noise**2 + light.rounding, 1e-12), settings.gain, light.rounding)


def _from_maps(shot: Shot, camera: Noise, steps: Steps, maps: Maps, settings: Settings) -> ExposureProfile:
    """Pixelation, border, mirror edges and lens; subtracts the shift by rounded grey values from the maps."""
    (raw, shared), setup, lit, decoders = maps, shot.setup, shot.lit, steps.decoders
    footprint = settings.footprint or 1.0
    widths = [usual_width(lit, own.coordinate, shared.flags, footprint) for own in raw]
    for decoder, own, width in zip(decoders, raw, widths, strict=True):
        corrected(own.coordinate, rounding_of(decoder, setup, width))
    shown = replace(setup.plan, axes=tuple(decoder.axis for decoder in decoders))
    pixelations = measured_pixelations(shown, raw, setup.cells, settings.blur_px, lit, footprint)
    borders = _borders(decoders, maps, pixelations) if setup.cells else [NO_BLUR] * len(raw)
    lens = _lens(shot, shown, maps, settings)
    axes = zip(decoders, widths, pixelations, borders, strict=True)
    return ExposureProfile(
        noise=setup.noise,
        camera=camera,
        silent=_silent(shot),
        lag=steps.lag,
        white=setup.white,
        axes=tuple(
            AxisProfile(one.axis.axis, one.numbers, width, cells, border)
            for one, width, cells, border in axes
        ),
        ends=end_width(shared.amplitude, shared.flags),
        dark=_dark_level(lit, shared),
        lens=lens,
        edges=np.zeros((len(raw), 4, 3), np.float32),
        shared=None,
        notices=(),
        sampled=NOTHING,
    )


def _lens(shot: Shot, shown: Plan, maps: Maps, settings: Settings) -> Lens:
    """Given or measured lens, or none; sigma includes the fill factor's, unless a footprint is given."""
    nothing = NO_LENS if settings.footprint is None else NO_LENS._replace(sigma=0.0)
    if settings.lens_px is not None:
        return nothing._replace(variance=settings.lens_px**2)
    coords = [own.coordinate for own in maps.raw]
    found = measured_lens(shown, shot.lit, coords, maps.shared.flags, settings.footprint or 1.0)
    return nothing if found is None else found


def _from_result(
    shot: Shot, steps: Steps, maps: Maps, profile: ExposureProfile, found: Correspondence
) -> ExposureProfile:
    """Add outermost lines, shared noise, notices and statistics of sample pixels."""
    lit, raw, flags, axes = shot.lit, maps.raw, found.flags, profile.axes
    shown = replace(shot.setup.plan, axes=tuple(decoder.axis for decoder in steps.decoders))
    in_common = {
        one.axis: math.hypot(one.pixelation.in_common(one.width, lit, *own, flags), decoder.stray)
        for own, one, decoder in zip(raw, axes, steps.decoders, strict=True)
    }
    coords = [{"u": found.u, "v": found.v}[one.axis] for one in axes]
    return replace(
        profile,
        edges=edge_lines(coords, flags),
        shared=shared_noise(shown, lit, _seen(shot, steps, maps, axes), in_common),
        notices=_notices(shot, steps, profile),
        sampled=sampled(shot.light, steps.setup, found),
    )


def _seen(shot: Shot, steps: Steps, maps: Maps, axes: tuple[AxisProfile, ...]) -> dict[str, Seen]:
    """Places of the sampled pixels per axis, NaN where flagged."""
    at, found = tuple(shot.lit.places.T), {}
    for decoder, own, one in zip(steps.decoders, maps.raw, axes, strict=True):
        place = np.where(maps.shared.flags[at] == 0, own.coordinate[at], np.float32(np.nan))
        spread = 0.0 if decoder.table is None else decoder.table.optics.with_cell
        found[one.axis] = Seen(place, one.width if shot.setup.cells else None, spread)
    return found


def _notices(shot: Shot, steps: Steps, profile: ExposureProfile) -> tuple[Notice, ...]:
    tables = [one.table for one in steps.decoders if one.table is not None]
    # as the variance of a sample over the squared amplitude
    between = [2 * (2 * np.pi) ** 2 * one.numbers.between for one in steps.decoders]
    misfit2 = max(profile.noise.misfit2, *(table.misfit2 for table in tables), *between, 0.0)
    roughness = max(one.pixelation.roughness for one in profile.axes)
    pairs = zip(steps.decoders, profile.axes, strict=True)
    return (
        *(notice for decoder, own in pairs for notice in decoder.notices(own.width)),
        *_noticed(_SLOW, profile.lag.share),
        *_noticed(_HELD, max(profile.lag.left.values(), default=0.0)),
        *_noticed(_BRIGHT, _too_bright(shot)),
        *_noticed(_STRAY, 2 * np.pi * max(one.numbers.stray for one in steps.decoders)),
        *_noticed(_MISFIT, misfit2**0.5),
        *_noticed(_ROUGH, roughness**0.5),
    )


def _noticed(what: tuple[str, str], size: float) -> tuple[Notice, ...]:
    """A notice of a deviation beyond noise; none if its size is 0."""
    return (Notice(what[0], size, 0.0, what[1]),) if size else ()


def _dark_level(lit: Sample, shared: Shared) -> float:
    """Level without light of the display, from the sampled pixels that are good so far."""
    level, amplitude, flags = (
        one[tuple(lit.places.T)] for one in (shared.offset, shared.amplitude, shared.flags)
    )
    return dark_level(level[flags == 0], amplitude[flags == 0])


def _borders(
    decoders: tuple[AxisDecoder, ...], maps: Maps, pixelations: list[Pixelation]
) -> list[BorderBlur]:
    """Border blur of each axis: measured at either border, or else an upper bound."""
    raw, shared = maps
    light = shared.offset, shared.amplitude
    shares = [border_shares(one) for one in decoders]
    told = [
        measured_blur(own.coordinate, shared.flags, light, one.axis.extent, share)
        for own, one, share in zip(raw, decoders, shares, strict=True)
    ]
    blur, count = max(told, key=lambda one: one[1])
    if count:
        return [blur] * len(decoders)
    bounds = [
        one.bound if decoder.table is None else decoder.table.optics.spread
        for decoder, one in zip(decoders, pixelations, strict=True)
    ]
    return [BorderBlur(bound, bound, bound, False) for bound in bounds]


def _too_bright(shot: Shot) -> float:
    """Share of pixels whose white saturates, if bits are compared with it; 0 if highlights explain it."""
    white = shot.setup.plan.white
    codes = [axis.code for axis in shot.setup.plan.axes if axis.code is not None]
    single = any((np.minimum(code.plain, code.inverse) < 0).any() for code in codes)
    if not single or white < 0 or not shot.lit.levels.size:
        return 0.0
    share = float((shot.lit.levels[white] >= shot.lit.white).mean())
    return share if share > _HIGHLIGHTS else 0.0


def _silent(shot: Shot) -> bool:
    """Whether there is no noise beyond rounding."""
    usual = float(shot.lit.levels.mean()) if shot.lit.levels.size else 0.0
    return bool(shot.setup.noise.variance(usual) < 1.5 * (shot.light.rounding or 1 / 12))
