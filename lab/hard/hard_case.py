"""A hard case, what it gave, and the verdict: nothing may be wrong that is not flagged; figures over all
draws of a family: shares of draws, of faults, of pixels.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np

from optolever.errors import InputError
from optolever.experiments.bench.measures import SIGMAS
from optolever.experiments.metrics import rms

from .found import Found, FrameVerdict, beyond, silent_mask

LIMIT = 1e-4  # silent errors, as a share of the unflagged pixels
RATIO = 1.1  # rms error over that of the reference, at most
LOSS = 0.03  # good share below that of the reference, at most
GOOD, REFUSED = "good", "refused"
FAULTS = (
    *("silent errors", "unflagged NaN", "diverged", "failed", "worse than alone", "fault missed"),
    *("right frame accused", "sigma too wide", "no notice"),
)
GOOD_EDGES = 0.95  # share of pixels away from edges that are to be good
FLAGGED = 0.05  # median over rigs of the flagged share of the pixels that see the pattern


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
        return Result(case, "failed", f"{type(error).__name__}: {error}")


def judged(case: Case, found: Found | tuple[FrameVerdict, ...]) -> Result:
    """The verdict: NaN or silent errors among unflagged pixels, errors as large as the subject itself; where
    there is a reference, what is worse than in that; of faults in frames, those that are missed.
    """
    if isinstance(found, tuple):
        return _of_faults(case, found)
    result, frames = _measured(case, found), found.frames
    told = frames is not None and (frames.fault or frames.accused)
    verdict, why = _of_frames(frames) if frames is not None and told else _of_pixels(result, found)
    return replace(result, verdict=verdict, why=why)


def _of_faults(case: Case, faults: tuple[FrameVerdict, ...]) -> Result:
    """The verdict on several faults of the same frames, each tried alone."""
    asked = [one for one in faults if one.counts]
    missed = [one.fault for one in asked if not one.named]
    what = f"{len(asked)} of {len(faults)} can be detected"
    share = len(missed) / max(len(asked), 1)
    if not missed:
        return Result(case, GOOD, what, silent=share)
    why = f"{', '.join(missed)}: {len(missed)} missed, {what}"
    return Result(case, "fault missed", why, silent=share, silent_count=len(missed))


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


def _of_pixels(result: Result, found: Found) -> tuple[str, str]:
    """Verdict on errors, and why; of a case with a reference relative to what the same pixels gave there."""
    case, unit = result.case, result.unit
    alone = None if found.reference is None else _measured(case, found.reference)
    share, pixels = (case.share, case.pixels) if alone is None else (alone.silent + LIMIT, 0)
    unknown = int(((found.flags == 0) & found.expected & ~np.isfinite(found.error)).sum())
    if unknown:
        return "unflagged NaN", f"{unknown} pixels"
    if result.silent > share and result.silent_count > pixels:
        return (
            ("cannot tell", case.limit) if case.limit else ("silent errors", f"{result.silent_count} pixels")
        )
    if unit != "px" and result.error > 1:
        return "diverged", ""
    if alone is not None and result.flagged > alone.flagged + LOSS:
        return "worse than alone", f"{100 * alone.flagged:.3g} % flagged alone"
    if alone is not None and result.error > RATIO * alone.error:
        return "worse than alone", f"{alone.error:.3g} {unit} rms alone"
    if result.flagged == 1:
        return GOOD, "all flagged"
    if found.width > found.width_limit:
        return "sigma too wide", f"{found.width:.1f} times the error"
    return "no notice" if found.notices == 0 else GOOD, ""


def _of_frames(frames: FrameVerdict) -> tuple[str, str]:
    """Verdict where frames were spoilt, or right ones accused, and why."""
    why = "; ".join(filter(None, (frames.fault, *frames.findings)))
    if not frames.fault:
        return "right frame accused", f"{frames.accused} times; {why}"
    if not frames.moves:
        return "harmless fault", why
    if frames.hidden:
        return "cannot tell", f"perfect frames of another scene: {why}"
    return "named" if frames.named else "not named", why


@dataclass(frozen=True, slots=True)
class Pooled:
    """A figure over `count` draws, faults or pixels, and its limit, if any: lower (at_least) or upper."""

    name: str
    value: float
    count: int
    limit: float | None = None
    at_least: bool = False

    @property
    def met(self) -> bool:
        """True within the limit, or of nothing."""
        if self.limit is None or math.isnan(self.value):
            return True
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "met": self.met}


def pooled(results: Iterable[Result]) -> list[Pooled]:
    """The figures of drawn rigs, scenes with edges, curved mirrors and wrong scenes; none without any."""
    listed = list(results)

    def drawn(part: str, name: str = "") -> list[Result]:
        return [one for one in listed if one.case.part == part and one.case.name.startswith(name)]

    figures = [*_of_rigs(drawn("decode", "random ")), *_of_edges(drawn("edges"))]
    for code, own in _grouped(drawn("curved"), lambda one: one.case.subject):
        figures += _of_code(code, own)
    for name, own in _grouped(drawn("scene"), lambda one: one.case.name.partition(":")[0]):
        figures += _of_scenes(name, own)
    return figures


def _grouped(results: list[Result], key: Callable[[Result], str]) -> Iterator[tuple[str, list[Result]]]:
    for name in dict.fromkeys(map(key, results)):
        yield name, [one for one in results if key(one) == name]


def _of_scenes(name: str, own: list[Result]) -> Iterator[Pooled]:
    """Of right or wrong scenes: how many are noticed, median error over the depth."""
    told = [one.frames.findings != () for one in own if one.frames is not None]
    errors = [one.error for one in own if not math.isnan(one.error)]
    if told:
        yield _share(f"{name}, noticed", sum(told), len(told))
    if errors:
        yield Pooled(f"{name}, error, median", float(np.median(errors)), len(errors))


def _of_code(code: str, own: list[Result]) -> Iterator[Pooled]:
    """Silent errors and scores of one code on all mirrors that bend inside of a pixel."""
    told = [(one.unflagged, one.normalised) for one in own if not math.isnan(one.normalised)]
    count = sum(pixels for pixels, _ in told)
    square = sum(pixels * score**2 for pixels, score in told) / max(count, 1)
    yield _silent(f"silent errors of {code} on curved mirrors", own, LIMIT)
    yield Pooled(f"rms(error / sigma) of {code} there (worse of u, v; true: 1.28)", math.sqrt(square), count)


def _of_rigs(rigs: list[Result]) -> Iterator[Pooled]:
    """A rig that is refused is flagged altogether."""
    if not rigs:
        return
    flagged = [1.0 if math.isnan(one.flagged) else one.flagged for one in rigs]
    scores = [one.normalised for one in rigs if not math.isnan(one.normalised)]
    score = float(np.median(scores)) if scores else math.nan
    yield _share("rigs failed", sum(one.fault for one in rigs), len(rigs), 0.0)
    yield _share("rigs refused", sum(one.verdict == REFUSED for one in rigs), len(rigs))
    yield _silent("silent errors on rigs, of unflagged pixels", rigs, LIMIT)
    yield Pooled("flagged share of a rig, median", float(np.median(flagged)), len(rigs), FLAGGED)
    yield Pooled("rms(error / sigma) of a rig, median (worse of u, v; true: 1.28)", score, len(scores))


def _of_edges(draws: list[Result]) -> Iterator[Pooled]:
    if not draws:
        return
    judged = [(one, one.frames) for one in draws if one.frames is not None]
    clean = [(one, frames) for one, frames in judged if not frames.fault]
    asked = [(one, frames) for one, frames in judged if frames.counts]
    right, wrong = [one for one, _ in clean], [one for one, _ in asked]
    good, pixels = sum(one.unflagged for one in right), sum(one.pixels for one in right)
    accused = sum(frames.accused > 0 for _, frames in clean)
    named = sum(frames.named for _, frames in asked)
    findings = sum(frames.findings != () for _, frames in clean)
    yield _share("right frames accused, of draws", accused, len(clean), 0.0)
    yield _share("wrong frames named, of faults that count", named, len(asked), 0.95, True)
    yield _share("good pixels away from edges", good, pixels, GOOD_EDGES, True)
    yield _silent("silent errors there, of unflagged pixels", right, LIMIT)
    yield _share("draws with a finding, of right ones", findings, len(clean))
    yield _silent("silent errors under faults that count", wrong)
    yield _share("draws refused or failed", len(draws) - len(judged), len(draws), 0.0)


def _silent(name: str, results: list[Result], limit: float | None = None) -> Pooled:
    return _share(
        name, sum(one.silent_count for one in results), sum(one.unflagged for one in results), limit
    )


def _share(name: str, some: float, count: int, limit: float | None = None, at_least: bool = False) -> Pooled:
    return Pooled(name, some / count if count else math.nan, count, limit, at_least)
