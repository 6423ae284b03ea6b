"""decode(): frames and their descriptions -> Correspondence; Decoder: many captures of one rig."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.errors import InputError
from optolever.notices import Notice
from optolever.patterns import Sequence
from optolever.records import LOG, Progress, logged, silent

from .apply import Prepared, applied
from .correspondence import Correspondence
from .exposures import better_of, by_exposure
from .float_frames import in_levels
from .frames import Light, light_of
from .plan import raster_axes
from .prepare import estimated, prepared
from .profile.pixelation import REACH
from .response import Response
from .rig_profile import RigProfile, Settings, digest
from .sampled import changes, sampled

__all__ = ["Decoder", "decode", "estimate_profile"]

_STEPS = 2
_OTHER = Notice(
    "the rig's profile is of another sequence, size or kind of frames",
    float("nan"),
    float("nan"),
    "estimated anew from this capture; estimate one from such frames",
)


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
    footprint: float | None = None,
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
    response     camera level against displayed level: a camera's is inverted first; of a display the light
                 of its levels is looked up (known cells and exposure of 1; else it is inverted, too)
    blur_px      rms blur between display and camera, cells; default: estimated (see display)
    lens_px      rms blur of the camera's lens, its pixels (4 at most), which smooths the map; its effect is
                 corrected; default: estimated from fringes (see lens), else 0 (a slanted edge, ISO 12233)
    footprint    side of a camera pixel's active area over its pitch (square root of the fill factor);
                 default: 1, with a sigma that allows a half
    on_cells     the display shows frames on the cells of a surface of the sequence's size, see Frame.tables,
                 dark around it; the resulting shifts are corrected (see display). False: ideal cosines
    subpixel     binary codes: coordinates within a cell, from the blur of edges, where it determines them
    mask         (H, W) bool: pixels to decode, the others are INVALID
    check        test whether the frames are those described (see integrity): a notice names wrong ones. The
                 code is decoded without them if it can be; else pixels that they may affect are flagged
    progress     called with step name, steps done, number of steps

    A code under several exposures is decoded from each complete exposure, and every pixel takes its best
    result: amplitude and offset are levels of that exposure. InputError if frames and sequence do not fit.
    """
    given = in_levels(frames)
    white = white_level and white_level * given.unit
    camera = noise and noise * given.unit, gain * given.unit, white, response
    settings = Settings(*camera, blur_px, lens_px, footprint, on_cells, subpixel, check)
    decoder = Decoder(sequence, settings=settings)
    return given.restored(decoder.decode(given.frames, mask=given.inside(mask), progress=progress))


def estimate_profile(
    frames: ArrayLike,
    sequence: Sequence,
    settings: Settings | None = None,
    *,
    mask: ArrayLike | None = None,
) -> RigProfile:
    """Profile of the rig, for further captures; see `decode` for the parameters."""
    decoder = Decoder(sequence, settings=settings)
    found = decoder.decode(frames, mask=mask)
    if decoder.profile is None:
        raise InputError(
            f"profile: {found.notices[-1]}; estimate it from a capture whose frames are those described"
        )
    return decoder.profile


class Decoder:
    """Decodes captures of one sequence on one rig: plan, tables and the rig's profile are made once.

    Each capture runs the kernels, and some pixels test the profile (noise, light, contrast, share of good
    pixels). If the test fails, or no profile fits the frames, the capture gives a new profile, as in
    `decode`; a notice names the change.
    """

    def __init__(
        self, sequence: Sequence, profile: RigProfile | None = None, settings: Settings | None = None
    ) -> None:
        """settings: default: those under which the profile was estimated."""
        raster_axes(sequence)  # checks all frames: one exposure's raster may be complete
        self._settings = settings or (Settings() if profile is None else profile.settings)
        _validated(self._settings)
        self._own, self._camera = _parted(sequence, self._settings)
        self._sequence, self._parts = sequence, by_exposure(sequence)
        self._profile = profile
        self._prepared: tuple[Prepared, ...] = ()

    @property
    def profile(self) -> RigProfile | None:
        """The last profile, estimated or given; None before the first capture."""
        return self._profile

    def decode(
        self, frames: ArrayLike, *, mask: ArrayLike | None = None, progress: Progress = silent
    ) -> Correspondence:
        """See `decode`."""
        light = self._light(frames, self._profile)
        inside = _mask(mask, light)
        with logged(f"decode {light.raw.shape} by {self._sequence.name}"):
            progress("decode", 0, _STEPS)
            found, doubts = self._by_profile(light, inside)
            if found is None:
                light = light if self._profile is None else self._light(frames, None)
                found = self._anew(light, inside, progress)
                found = replace(found, notices=doubts + found.notices)
            progress("decoded", _STEPS, _STEPS)
        for notice in found.notices:
            LOG.warning("%s", notice)
        return found

    def _light(self, frames: ArrayLike, known: RigProfile | None) -> Light:
        """Frames with the clip level of a known camera, else with one estimated from all samples."""
        white, rounding = self._settings.white_level, None
        if known is not None and known.dtype == getattr(frames, "dtype", None):
            white, rounding = known.clip, known.rounding
        return light_of(frames, self._sequence, white, self._camera, rounding)

    def _by_profile(
        self, light: Light, mask: NDArray[np.bool_] | None
    ) -> tuple[Correspondence | None, tuple[Notice, ...]]:
        """None where no profile fits these frames or the profile no longer holds; notices give the reason."""
        if self._profile is None:
            return None, ()
        if not self._prepared:
            if not self._fits(self._profile, light):
                return None, (_OTHER,)
            every = zip(self._parts, self._profile.exposures, strict=True)
            self._prepared = tuple(prepared(part, self._own, one, light) for part, one in every)
        if light.raw.shape[1:] != self._profile.shape:
            return None, (_OTHER,)
        found = []
        for one in self._prepared:
            own = one.steps.light(light.only(one.part.index))
            found.append(applied(own, one, mask))
            doubts = changes(one.profile.sampled, sampled(own, one.steps.setup, found[-1]))
            if doubts:
                return None, doubts
        return reduce(better_of, found), ()

    def _fits(self, profile: RigProfile, light: Light) -> bool:
        """Whether a profile fits the frames: sequence, size and type."""
        kind = profile.sequence, profile.shape, profile.dtype, len(profile.exposures)
        return kind == (digest(self._sequence), light.raw.shape[1:], light.raw.dtype.name, len(self._parts))

    def _anew(self, light: Light, mask: NDArray[np.bool_] | None, progress: Progress) -> Correspondence:
        """Estimate the profile, and decode by it."""
        done = [estimated(light.only(part.index), part, self._own, mask) for part in self._parts]
        found = reduce(better_of, (one.found for one in done))
        if any(one.findings for one in done):  # a fault of this capture, not of the rig
            return found
        self._prepared = tuple(one.prepared for one in done)
        self._profile = RigProfile(
            sequence=digest(self._sequence),
            shape=light.raw.shape[1:],
            dtype=light.raw.dtype.name,
            clip=light.clip,
            rounding=light.rounding,
            settings=self._settings,
            exposures=tuple(one.profile for one in self._prepared),
        )
        return found


def _mask(mask: ArrayLike | None, light: Light) -> NDArray[np.bool_] | None:
    if mask is None:
        return None
    inside, shape = np.asarray(mask), light.raw.shape[1:]
    if inside.shape != shape or inside.dtype != np.bool_:
        raise InputError(f"decode: mask is {inside.dtype} {inside.shape}, must be bool {shape}")
    return inside


def _validated(settings: Settings) -> None:
    """InputError where a number exceeds its limits."""
    for name in ("noise", "gain"):
        value = getattr(settings, name)
        if value is not None and not 0 <= value < np.inf:
            raise InputError(f"decode: {name} is {value}, must be finite and at least 0")
    # curvature is estimated over so many pixels
    if settings.lens_px is not None and not 0 <= settings.lens_px <= REACH:
        raise InputError(f"decode: lens_px is {settings.lens_px}, must be 0 to {REACH}")
    if settings.footprint is not None and not 0 < settings.footprint <= 1:
        raise InputError(f"decode: footprint is {settings.footprint}, must be above 0, 1 at most")


def _parted(sequence: Sequence, settings: Settings) -> tuple[Settings, Response | None]:
    """Split the response from the settings: a display's stays in them if its light is looked up (known cells,
    exposure of 1); else levels are inverted, as for a camera's."""
    response = settings.response
    known = not sequence.nominal and all(frame.exposure == 1 for frame in sequence.frames)
    if response is None or response.blur is None or not settings.on_cells or not known:
        return replace(settings, response=None), response
    told = settings.blur_px is None and not np.isnan(response.blur)
    return replace(settings, blur_px=response.blur if told else settings.blur_px), None
