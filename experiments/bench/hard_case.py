"""A hard case, what it gave, and the verdict: nothing may be wrong that is not flagged."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

from ..metrics import rms

__all__ = ["LIMIT", "SIGMAS", "Case", "Found", "FrameVerdict", "Result", "judged", "run_case"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

LIMIT = 1e-4  # silent errors, as a share of the unflagged pixels
SIGMAS = 5.0  # beyond which an unflagged value is a silent error
GOOD, SILENT, UNKNOWN, DIVERGED, REFUSED, BROKEN, LIMITED = (
    "good",
    "silent errors",
    "unflagged NaN",
    "diverged",
    "refused",
    "failed",
    "cannot tell",
)
ACCUSED, NAMED, UNNAMED, HARMLESS = "right frame accused", "named", "not named", "harmless fault"
WIDE, UNSAID = "sigma too wide", "no notice"
FAULTS = (SILENT, UNKNOWN, DIVERGED, BROKEN, ACCUSED, WIDE, UNSAID)


@dataclass(frozen=True, slots=True)
class FrameVerdict:
    """What was said about whole frames.

    fault: what was done to the frames ('': nothing); moves: whether it moves the place of enough pixels;
    perfect: whether the frames are now perfect ones of another scene, so that nobody could tell; named:
    whether it was; accused: pixels flagged WRONG_FRAME and nothing else; findings: sentences.
    """

    fault: str
    moves: bool
    perfect: bool
    named: bool
    accused: int
    findings: tuple[str, ...] = ()

    @property
    def counts(self) -> bool:
        """True if the fault has to be named."""
        return self.moves and not self.perfect


@dataclass(frozen=True, slots=True)
class Found:
    """What a case gave, (H, W) each.

    error: signed, of one coordinate or of the height (the worse one in units of its limit), NaN where the
    value is; limit: error beyond which an unflagged value is a silent one; expected: pixels that see the
    pattern; beside: pixels from which no light of the pattern can come; flags; unit: of the errors; scale:
    what the rms is divided by; silent_limit: share of silent errors that is allowed; frames: what was said
    about whole frames, where that is judged; width: median sigma over the rms error, at most width_limit;
    notices: how many there are, where there must be one.
    """

    error: Floats
    limit: Floats
    expected: Mask
    beside: Mask
    flags: NDArray[np.integer[Any]]
    unit: str
    scale: float = 1.0
    silent_limit: float = LIMIT
    frames: FrameVerdict | None = None
    width: float = math.nan
    width_limit: float = math.inf
    notices: int | None = None


@dataclass(frozen=True, slots=True)
class Case:
    """One hard case: a pure function of nothing.

    part: decode | reconstruct; name: what is hard; subject: sequence or solver; limit: why nobody could tell
    from these frames that they are wrong ('': it can be told).
    """

    part: str
    name: str
    subject: str
    size: tuple[int, int]
    make: Callable[[], Found] = field(compare=False)
    noise: float = 0.0
    dtype: str = "float64"
    limit: str = ""

    @property
    def label(self) -> str:
        """One line that names the case; --filter looks for parts of it."""
        rows, cols = self.size
        return f"{self.part} {self.name} {self.subject} {rows}x{cols} noise={self.noise:g} {self.dtype}"


@dataclass(frozen=True, slots=True)
class Result:
    """A case's verdict. error: rms of the unflagged, in `unit`; worst: over its limit (above 1: silent);
    flagged, wrong: shares of the pixels that see the pattern, those beyond their limit whether flagged or
    not; silent: share of the unflagged, and their count; pixels: that see the pattern; width: median sigma
    over rms error; found: None if nothing was.
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
        return {
            "part": case.part,
            "case": case.name,
            "subject": case.subject,
            "size": list(case.size),
            "noise": case.noise,
            "dtype": case.dtype,
            "verdict": self.verdict,
            "why": self.why,
            "error": self.error,
            "unit": self.unit,
            "worst": self.worst,
            "flagged": self.flagged,
            "wrong": self.wrong,
            "silent": self.silent,
            "silent_count": self.silent_count,
            "pixels": self.pixels,
            "width": self.width,
            "frames": None if self.frames is None else asdict(self.frames),
        }


def run_case(case: Case) -> Result:
    """Run a case and judge it."""
    try:
        return judged(case, case.make())
    except InputError as error:
        return Result(case, REFUSED, str(error))
    except Exception as error:
        return Result(case, BROKEN, f"{type(error).__name__}: {error}")


def judged(case: Case, found: Found) -> Result:
    """The verdict: NaN or silent errors among unflagged pixels, errors as large as the subject itself."""
    stands = found.flags == 0
    seen = stands & found.expected
    unknown = int((seen & ~np.isfinite(found.error)).sum())
    off = silent_mask(found)
    count, total = int(off.sum()), int(stands.sum())
    errors = found.error[seen & np.isfinite(found.error)]
    share = count / total if total else 0.0
    expected = int(found.expected.sum())
    result = Result(
        case,
        GOOD,
        error=rms(errors) / found.scale,
        unit=found.unit,
        worst=float(np.max(np.abs(errors) / found.limit[seen & np.isfinite(found.error)], initial=0.0)),
        flagged=1.0 - float(seen.sum()) / expected if expected else math.nan,
        wrong=float((_beyond(found) & found.expected).sum()) / expected if expected else math.nan,
        silent=share,
        silent_count=count,
        pixels=expected,
        width=found.width,
        frames=found.frames,
        found=found,
    )
    return _with_verdict(result, found, unknown)


def silent_mask(found: Found) -> Mask:
    """Unflagged pixels that are off by more than their limit, or see nothing at all."""
    return np.asarray((found.flags == 0) & ((_beyond(found) & found.expected) | found.beside))


def _beyond(found: Found) -> Mask:
    with np.errstate(invalid="ignore"):
        return np.asarray(~(np.abs(found.error) <= found.limit))


def _with_verdict(result: Result, found: Found, unknown: int) -> Result:
    if found.frames is not None and (found.frames.fault or found.frames.accused):
        return _of_frames(result, found.frames)
    if unknown:
        return replace(result, verdict=UNKNOWN, why=f"{unknown} pixels")
    if result.silent > found.silent_limit:
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
        return replace(result, verdict=ACCUSED, why=f"{frames.accused} pixels; {why}")
    if not frames.moves:
        return replace(result, verdict=HARMLESS, why=why)
    if frames.perfect:
        return replace(result, verdict=LIMITED, why=f"perfect frames of another scene: {why}")
    return replace(result, verdict=NAMED if frames.named else UNNAMED, why=why)
