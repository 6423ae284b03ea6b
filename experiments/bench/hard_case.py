"""A hard case, what it gave, and the verdict: nothing may be wrong that is not flagged."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

from ..metrics import rms

__all__ = ["LIMIT", "SIGMAS", "Case", "Found", "Result", "judged", "run_case"]

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
FAULTS = (SILENT, UNKNOWN, DIVERGED, BROKEN)


@dataclass(frozen=True, slots=True)
class Found:
    """What a case gave, (H, W) each.

    error: signed, of one coordinate or of the height (the worse one in units of its limit), NaN where the
    value is; limit: error beyond which an unflagged value is a silent one; expected: pixels that see the
    pattern; beside: pixels from which no light of the pattern can come; flags; unit: of the errors; scale:
    what the rms is divided by.
    """

    error: Floats
    limit: Floats
    expected: Mask
    beside: Mask
    flags: NDArray[np.integer[Any]]
    unit: str
    scale: float = 1.0


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
    not; silent: share of the unflagged, and their count; found: None if nothing was.
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
        found=found,
    )
    return _with_verdict(result, unknown, share)


def silent_mask(found: Found) -> Mask:
    """Unflagged pixels that are off by more than their limit, or see nothing at all."""
    return np.asarray((found.flags == 0) & ((_beyond(found) & found.expected) | found.beside))


def _beyond(found: Found) -> Mask:
    with np.errstate(invalid="ignore"):
        return np.asarray(~(np.abs(found.error) <= found.limit))


def _with_verdict(result: Result, unknown: int, share: float) -> Result:
    if unknown:
        return replace(result, verdict=UNKNOWN, why=f"{unknown} pixels")
    if share > LIMIT:
        if result.case.limit:
            return replace(result, verdict=LIMITED, why=result.case.limit)
        return replace(result, verdict=SILENT, why=f"{result.silent_count} pixels")
    if result.unit != "px" and result.error > 1:
        return replace(result, verdict=DIVERGED)
    if result.flagged == 1:
        return replace(result, why="all flagged")
    return result
