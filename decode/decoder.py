"""decode(): frames and their descriptions -> Correspondence; Decoder: many captures of one rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.blocks import blas_on_one
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.patterns import Sequence
from optolever.records import LOG, Progress, logged, silent
from optolever.schema import checked

from .correspondence import Correspondence
from .frames import Levels, Light, Response, Settings, in_levels, light_of
from .pipeline import Prepared, applied, estimated, holds, prepared
from .plan import plan
from .profile import RigProfile, digest

__all__ = ["Decoder", "decode", "estimate_profile"]

_STEPS = 2
#: Largest blur of a lens, px of the camera.
_LENS = 4.0
_OTHER = Notice.plain(
    "the rig's profile is of another sequence, size or kind of frames",
    "this capture is decoded by its own; store that: optolever decode --save-profile",
)


@checked(sequence=Sequence, response=Response)
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
    mask: ArrayLike | None = None,
    progress: Progress = silent,
) -> Correspondence:
    """Where on the pattern every camera pixel looks.

    frames       (N, H, W) uint8 or uint16 (floats of any unit are taken, too; pixels that are not finite are
                 INVALID), frame i as sequence.frames[i] describes it
    noise, gain  of the camera: variance = noise^2 + gain * level, levels of the frames before rounding;
                 without `noise` both are estimated from the frames, and so is what fringes are off beyond it
    white_level  level at which the camera clips; default 255, for uint16 the 10, 12, 14 or 16 bits in use
    response     of a display (with a blur): phases and look-ups follow its light; of a camera: inverted first
    blur_px      rms blur between display and camera, cells, for `response` and look-ups of grey values, which
                 otherwise fit it
    lens_px      rms blur of the camera's lens, its pixels (4 at most), which smooths the map; its effect is
                 corrected; default: 0.28, with a sigma that allows 0 to 0.6 (a slanted edge, ISO 12233)
    on_cells     the display shows frames on the cells of a surface of the sequence's size, see Frame.tables,
                 dark around it. False: ideal cosines without a border
    mask         (H, W) bool: pixels to decode, the others are INVALID
    progress     called with step name, steps done, number of steps

    InputError if frames and sequence do not fit.
    """
    settings = Settings(noise, gain, white_level, response, blur_px, lens_px, on_cells)
    return Decoder(sequence, settings=settings).decode(frames, mask=mask, progress=progress)


def estimate_profile(
    frames: ArrayLike, sequence: Sequence, settings: Settings | None = None, *, mask: ArrayLike | None = None
) -> RigProfile:
    """Profile of the rig, for further captures; see `decode` for the parameters."""
    decoder = Decoder(sequence, settings=settings)
    found = decoder.decode(frames, mask=mask)
    if decoder.profile is None:
        raise InputError(
            f"profile: {found.notices[-1]}; estimate it from a capture that agrees with its description"
        )
    return decoder.profile


class Decoder:
    """Decodes captures of one sequence on one rig: plan, tables and the rig's profile are made once.

    Each capture runs the kernels, and some pixels test the profile (residuals, contrast, share of good
    pixels). If the test fails, or no profile fits the frames, the capture gives a new profile, as in
    `decode`; a notice names the change.
    """

    def __init__(
        self, sequence: Sequence, profile: RigProfile | None = None, settings: Settings | None = None
    ) -> None:
        """settings: default: those under which the profile was estimated."""
        self._settings = settings or (Settings() if profile is None else profile.settings)
        _validated(self._settings)
        plan(sequence)  # checks the frames
        self._sequence, self._digest, self._profile = sequence, digest(sequence), profile
        self._prepared: Prepared | None = None

    @property
    def profile(self) -> RigProfile | None:
        """The last profile, estimated or given; None before the first capture."""
        return self._profile

    def decode(
        self, frames: ArrayLike, *, mask: ArrayLike | None = None, progress: Progress = silent
    ) -> Correspondence:
        """See `decode`."""
        given = in_levels(frames)
        light = self._light(given, self._profile)
        inside = _mask(given.inside(mask), light)
        with logged(f"decode {light.raw.shape} by {self._sequence.name}"):
            progress("decode", 0, _STEPS)
            found, doubts = self._by_profile(light, inside)
            if found is None:
                light = light if self._profile is None else self._light(given, None)
                found = self._anew(light, inside, given.unit)
                found = replace(found, notices=doubts + found.notices)
            progress("decoded", _STEPS, _STEPS)
        for notice in found.notices:
            LOG.warning("%s", notice)
        return given.restored(found)

    def _light(self, given: Levels, known: RigProfile | None) -> Light:
        """Frames with the clip level of a known camera, else with one estimated from all samples."""
        white, rounding = self._settings.white_level, None
        white = white and white * given.unit
        if known is not None and known.dtype == getattr(given.frames, "dtype", None):
            white, rounding = known.clip, known.rounding
        return light_of(given.frames, self._sequence, white, self._settings.response, rounding)

    def _by_profile(
        self, light: Light, mask: NDArray[np.bool_] | None
    ) -> tuple[Correspondence | None, tuple[Notice, ...]]:
        """None where no profile fits these frames or the profile no longer holds; notices give the reason."""
        known = self._profile
        if known is None:
            return None, ()
        kind, part = (self._digest, light.raw.dtype.name), zip(light.raw.shape[1:], known.shape, strict=True)
        if kind != (known.sequence, known.dtype) or any(here > whole for here, whole in part):
            self._prepared = None
            return None, (_OTHER,)
        if self._prepared is None:
            self._prepared = prepared(self._sequence, self._settings, known.estimates)
        doubts = holds(light, self._prepared, mask)
        return (None, doubts) if doubts else (applied(light, self._sequence, self._prepared, mask), ())

    def _anew(self, light: Light, mask: NDArray[np.bool_] | None, unit: float) -> Correspondence:
        """Estimate the profile, and decode by it."""
        settings = self._settings
        if settings.noise is not None:
            settings = replace(settings, noise=settings.noise * unit, gain=settings.gain * unit)
        with blas_on_one():  # of small matrices: a second thread made this take 1.5 times as long
            found, ready = estimated(light, self._sequence, settings, mask)
        if ready is not None:  # else a fault of this capture, not of the rig
            kind, camera = (light.raw.shape[1:], light.raw.dtype.name), (light.clip, light.rounding)
            self._prepared = ready
            self._profile = RigProfile(self._digest, *kind, *camera, self._settings, ready.profile)
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
    if settings.lens_px is not None and not 0 <= settings.lens_px <= _LENS:
        raise InputError(f"decode: lens_px is {settings.lens_px}, must be 0 to {_LENS}")
