"""A hard case, what it gave, and the verdict: nothing may be wrong that is not flagged."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np

from optolever.errors import InputError

from ..metrics import rms
from .found import SIGMAS, Found, FrameVerdict, beyond, silent_mask

__all__ = ["LIMIT", "Case", "Result", "judged", "run_case"]

LIMIT = 1e-4  # silent errors, as a share of the unflagged pixels
RATIO = 1.1  # rms error over that of the reference, at most
LOSS = 0.03  # good share below that of the reference, at most
GOOD, SILENT, UNKNOWN, DIVERGED, REFUSED, BROKEN, LIMITED, WORSE, MISSED = (
    "good",
    "silent errors",
    "unflagged NaN",
    "diverged",
    "refused",
    "failed",
    "cannot tell",
    "worse than alone",
    "fault missed",
)
ACCUSED, NAMED, UNNAMED, HARMLESS = "right frame accused", "named", "not named", "harmless fault"
WIDE, UNSAID = "sigma too wide", "no notice"
FAULTS = (SILENT, UNKNOWN, DIVERGED, BROKEN, WORSE, MISSED, ACCUSED, WIDE, UNSAID)


@dataclass(frozen=True, slots=True)
class Case:
    """One hard case: a pure function of nothing.

    part: decode | reconstruct; name: what is hard; subject: sequence or solver; limit: why nobody could tell
    from these frames that they are wrong ('': it can be told); share, pixels: silent errors that pass, as a
    share of the unflagged pixels and as a count, whichever is more.
    """

    part: str
    name: str
    subject: str
    size: tuple[int, int]
    make: Callable[[], "Found | tuple[FrameVerdict, ...]"] = field(compare=False)
    noise: float = 0.0
    dtype: str = "float64"
    limit: str = ""
    share: float = LIMIT
    pixels: int = 0

    @property
    def label(self) -> str:
        """One line that names the case; --filter looks for parts of it."""
        rows, cols = self.size
        return f"{self.part} {self.name} {self.subject} {rows}x{cols} noise={self.noise:g} {self.dtype}"


@dataclass(frozen=True, slots=True)
class Result:
    """A case's verdict. error: rms of the unflagged, in `unit`; worst: over its limit (above 1: silent);
    flagged, wrong: shares of the pixels that see the pattern, those beyond their limit whether flagged or
    not; silent: share of the unflagged, and their count; pixels: that see the pattern; unflagged: pixels;
    normalised: rms of their errors in units of sigma (of the worse coordinate: 1.28 if both sigmas are true);
    width: median sigma over rms error; found: None if nothing was.
    """

    case: Case
    verdict: str
    why: str = ""
    error: float = math.nan
    unit: str = ""
    worst: float = math.nan
    flagged: float = math.nan
    wrong: float = math.nan
    silent: float = math.nan
    silent_count: int = 0
    pixels: int = 0
    unflagged: int = 0
    normalised: float = math.nan
    width: float = math.nan
    frames: FrameVerdict | None = None
    found: Found | None = None

    @property
    def fault(self) -> bool:
        """True if the case is silently wrong, or breaks."""
        return self.verdict in FAULTS

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        case = self.case
        of_case = {"part": case.part, "case": case.name, "subject": case.subject, "size": list(case.size)}
        own = {one.name: getattr(self, one.name) for one in fields(self) if one.name not in ("case", "found")}
        frames = None if self.frames is None else asdict(self.frames)
        return {**of_case, "noise": case.noise, "dtype": case.dtype, **own, "frames": frames}


def run_case(case: Case) -> Result:
    """Run a case and judge it."""
    try:
        return judged(case, case.make())
    except InputError as error:
        return Result(case, REFUSED, str(error))
    except Exception as error:
        return Result(case, BROKEN, f"{type(error).__name__}: {error}")


def judged(case: Case, found: Found | tuple[FrameVerdict, ...]) -> Result:
    """The verdict: NaN or silent errors among unflagged pixels, errors as large as the subject itself; where
    there is a reference, what is worse than in that; of faults in frames, those that are missed.
    """
    if isinstance(found, tuple):
        return _of_faults(case, found)
    result = _measured(case, found)
    if found.frames is not None and (found.frames.fault or found.frames.accused):
        return _of_frames(result, found.frames)
    if found.reference is None:
        return _with_verdict(result, found, case.share, case.pixels)
    return _compared(result, found, _measured(case, found.reference))


def _of_faults(case: Case, faults: tuple[FrameVerdict, ...]) -> Result:
    """The verdict on several faults of the same frames, each tried alone."""
    asked = [one for one in faults if one.counts]
    missed = [one.fault for one in asked if not one.named]
    what = f"{len(asked)} of {len(faults)} can be detected"
    why = f"{', '.join(missed)}: {len(missed)} missed, {what}" if missed else what
    result = Result(case, MISSED if missed else GOOD, why, silent=len(missed) / max(len(asked), 1))
    return replace(result, silent_count=len(missed))


def _compared(result: Result, found: Found, reference: Result) -> Result:
    """The verdict relative to a reference of the same pixels."""
    judged = _with_verdict(result, found, reference.silent + LIMIT, 0)
    if judged.fault:
        return judged
    if result.flagged > reference.flagged + LOSS:
        return replace(result, verdict=WORSE, why=f"{100 * reference.flagged:.3g} % flagged alone")
    if result.error > RATIO * reference.error:
        return replace(result, verdict=WORSE, why=f"{reference.error:.3g} {result.unit} rms alone")
    return judged


def _measured(case: Case, found: Found) -> Result:
    """The numbers of a result."""
    stands = found.flags == 0
    seen = stands & found.expected
    off = silent_mask(found)
    count, total = int(off.sum()), int(stands.sum())
    finite = seen & np.isfinite(found.error)
    errors = found.error[finite]
    ratios = np.abs(errors) / found.limit[finite]
    share = count / total if total else 0.0
    expected = int(found.expected.sum())
    return Result(
        case,
        GOOD,
        error=rms(errors) / found.scale,
        unit=found.unit,
        worst=float(np.max(ratios, initial=0.0)),
        flagged=1.0 - float(seen.sum()) / expected if expected else math.nan,
        wrong=float((beyond(found) & found.expected).sum()) / expected if expected else math.nan,
        silent=share,
        silent_count=count,
        pixels=expected,
        unflagged=total,
        normalised=SIGMAS * rms(ratios),
        width=found.width,
        frames=found.frames,
        found=found,
    )


def _with_verdict(result: Result, found: Found, share: float, pixels: int) -> Result:
    """share, pixels: silent errors that pass, of the unflagged and as a count."""
    unknown = int(((found.flags == 0) & found.expected & ~np.isfinite(found.error)).sum())
    if unknown:
        return replace(result, verdict=UNKNOWN, why=f"{unknown} pixels")
    if result.silent > share and result.silent_count > pixels:
        if result.case.limit:
            return replace(result, verdict=LIMITED, why=result.case.limit)
        return replace(result, verdict=SILENT, why=f"{result.silent_count} pixels")
    if result.unit != "px" and result.error > 1:
        return replace(result, verdict=DIVERGED)
    if result.flagged == 1:
        return replace(result, why="all flagged")
    if found.width > found.width_limit:
        return replace(result, verdict=WIDE, why=f"{found.width:.1f} times the error")
    return replace(result, verdict=UNSAID) if found.notices == 0 else result


def _of_frames(result: Result, frames: FrameVerdict) -> Result:
    """The verdict where frames were spoilt, or right ones accused."""
    why = "; ".join(filter(None, (frames.fault, *frames.findings)))
    if not frames.fault:
        return replace(result, verdict=ACCUSED, why=f"{frames.accused} times; {why}")
    if not frames.moves:
        return replace(result, verdict=HARMLESS, why=why)
    if frames.hidden:
        return replace(result, verdict=LIMITED, why=f"perfect frames of another scene: {why}")
    return replace(result, verdict=NAMED if frames.named else UNNAMED, why=why)
