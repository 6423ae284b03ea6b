"""A hard case, what it gave, and the verdict: nothing may be wrong that is not flagged."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

from ..metrics import rms

__all__ = ["LIMIT", "SIGMAS", "Case", "Faults", "Found", "Result", "judged", "run_case"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

LIMIT = 1e-4  # silent errors, as a share of the unflagged pixels
SIGMAS = 5.0  # beyond which an unflagged value is a silent error
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
FAULTS = (SILENT, UNKNOWN, DIVERGED, BROKEN, WORSE, MISSED)


@dataclass(frozen=True, slots=True)
class Found:
    """What a case gave, (H, W) each.

    error: signed, of one coordinate or of the height (the worse one in units of its limit), NaN where the
    value is; limit: error beyond which an unflagged value is a silent one; expected: pixels that see the
    pattern; beside: pixels from which no light of the pattern can come; flags; unit: of the errors; scale:
    what the rms is divided by; reference: what the same pixels gave under better conditions, if the verdict
    is relative to that.
    """

    error: Floats
    limit: Floats
    expected: Mask
    beside: Mask
    flags: NDArray[np.integer[Any]]
    unit: str
    scale: float = 1.0
    reference: "Found | None" = None


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults of frames, by name: which are detected, which should be, which of these are not."""

    names: tuple[str, ...]
    detected: tuple[bool, ...]
    expected: tuple[bool, ...]

    @property
    def missed(self) -> list[str]:
        """Names of those that should be detected and are not."""
        each = zip(self.names, self.detected, self.expected, strict=True)
        return [name for name, detected, expected in each if expected and not detected]


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
    make: Callable[[], Found | Faults] = field(compare=False)
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
    not; silent: share of the unflagged, and their count; unflagged: pixels; normalised: rms of their
    errors in units of sigma (of the worse coordinate: 1.28 if both sigmas are true); found: None if nothing
    was.
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
    unflagged: int = 0
    normalised: float = math.nan
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
            "unflagged": self.unflagged,
            "normalised": self.normalised,
        }


def run_case(case: Case) -> Result:
    """Run a case and judge it."""
    try:
        return judged(case, case.make())
    except InputError as error:
        return Result(case, REFUSED, str(error))
    except Exception as error:
        return Result(case, BROKEN, f"{type(error).__name__}: {error}")


def judged(case: Case, found: Found | Faults) -> Result:
    """The verdict: NaN or silent errors among unflagged pixels, errors as large as the subject itself; where
    there is a reference, what is worse than in that; of faults, those that are missed.
    """
    if isinstance(found, Faults):
        missed, expected = found.missed, max(sum(found.expected), 1)
        result = Result(case, MISSED if missed else GOOD, silent=len(missed) / expected)
        return replace(result, silent_count=len(missed), why=_listed(missed, found))
    result = _measured(case, found)
    if found.reference is None:
        return _with_verdict(result, case.share, case.pixels)
    return _compared(result, _measured(case, found.reference))


def _listed(missed: list[str], found: Faults) -> str:
    what = f"{sum(found.expected)} of {len(found.names)} can be detected"
    return f"{', '.join(missed)}: {len(missed)} missed, {what}" if missed else what


def _compared(result: Result, reference: Result) -> Result:
    """The verdict relative to a reference of the same pixels."""
    judged = _with_verdict(result, reference.silent + LIMIT, 0)
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
        wrong=float((_beyond(found) & found.expected).sum()) / expected if expected else math.nan,
        silent=share,
        silent_count=count,
        unflagged=total,
        normalised=SIGMAS * rms(ratios),
        found=found,
    )


def silent_mask(found: Found) -> Mask:
    """Unflagged pixels that are off by more than their limit, or see nothing at all."""
    return np.asarray((found.flags == 0) & ((_beyond(found) & found.expected) | found.beside))


def _beyond(found: Found) -> Mask:
    with np.errstate(invalid="ignore"):
        return np.asarray(~(np.abs(found.error) <= found.limit))


def _with_verdict(result: Result, share: float, pixels: int) -> Result:
    """share, pixels: silent errors that pass, of the unflagged and as a count."""
    unknown = 0 if result.found is None else _unknown(result.found)
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
    return result


def _unknown(found: Found) -> int:
    """Unflagged pixels that see the pattern and have no value."""
    return int(((found.flags == 0) & found.expected & ~np.isfinite(found.error)).sum())
