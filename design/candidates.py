"""Candidate sequences for a number of frames: every family of codes with parameters that use the budget, and
a user's sequences: a Python callable, a folder of images with a description, or a name.
"""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence, bits_for, packed, sequence_from_text, sequence_names
from optolever.samples import UserDecoder, UserImages, user_decoder, user_sequence

#: Periods whose half is an integer number of cells: a Gray code cannot represent others exactly.
EVEN_PERIODS = (4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)
PERIODS = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)
#: Number of fringes n of the longer of two periods; n and n + 1 fringes are unambiguous together.
PAIRS = (5, 8, 12, 15, 18, 22, 27, 33, 40, 50, 60, 75, 90, 110)
LEAST_STEPS = 3
SPAN = 1.125  # coarsest period over the surface's extent: above 1, its ends differ
#: Sequences without a dense, absolute map from their frames alone.
NOT_DENSE = ("lattice", "crossed", "ramp")


@dataclass(frozen=True, slots=True)
class Candidate:
    """A sequence, or a user's images, and its name; text: of a named one, the argument on the command line.
    decoder: the user's; such a candidate is simulated only, without a prediction."""

    text: str
    pattern: Sequence | UserImages
    decoder: UserDecoder | None = None

    @property
    def name(self) -> str:
        """The argument of a named sequence; of a file or folder its name, of a function that."""
        pattern, decoder = _halves(self.text)
        first, _, function = pattern.partition(":")
        if first not in sequence_names():
            pattern = Path(pattern).stem if Path(pattern).exists() else function or pattern
        return f"{pattern} ({decoder.partition(':')[2]})" if decoder else pattern

    @property
    def sequence(self) -> Sequence:
        """InputError for images."""
        if isinstance(self.pattern, UserImages):
            raise InputError(f"pattern {self.text!r}: is images, name a decoder: {self.text}@MODULE:FUNCTION")
        return self.pattern


def candidates(rows: int, cols: int, frames: int) -> list[Candidate]:
    """Every candidate of at most `frames` frames for a surface of rows x cols cells."""
    found: dict[str, Candidate] = {}
    texts = [*_gray_phase(rows, cols, frames), *_together(rows, cols, frames), *_codes(frames)]
    for text in texts:
        _add(found, text, rows, cols, frames)
    for candidate in _ladders(rows, cols, frames):
        found.setdefault(candidate.text, candidate)
    named = {text.partition(":")[0] for text in texts} | {"phase"}
    for name in sequence_names():
        if name not in named and name not in NOT_DENSE:
            _add(found, name, rows, cols, frames)
    return list(found.values())


def in_colour(grey: Iterable[Candidate], stripes: str, most: float = math.inf) -> Iterator[Candidate]:
    """Those that can be shown in colour, packed, of at most `most` pictures."""
    for one in grey:
        try:
            shown = packed(one.sequence, stripes)
        except InputError:  # kinds of frames that are shown in grey alone, images, stripes that forbid it
            continue
        if one.decoder is None and shown.exposures <= most:
            yield Candidate(f"{one.text} --colour {stripes}", shown)


def _add(found: dict[str, Candidate], text: str, rows: int, cols: int, frames: int) -> None:
    try:
        sequence = sequence_from_text(text, rows, cols)
    except InputError:  # a surface too small or too large for this code
        return
    if len(sequence) <= frames:
        found.setdefault(text, Candidate(text, sequence))


def _gray_phase(rows: int, cols: int, frames: int) -> Iterator[str]:
    """White, black, Gray bits of cells of half a period, and phase steps in the remaining frames."""
    for period in EVEN_PERIODS:
        bits = sum(bits_for(math.ceil(extent / (period / 2))) for extent in (rows, cols))
        steps = (frames - 2 - bits) // 2
        if steps >= LEAST_STEPS:
            yield f"gray+phase:period={period:g},steps={steps}"


def _together(rows: int, cols: int, frames: int) -> Iterator[str]:
    """Periods that are unambiguous only together: two whose numbers of fringes differ by one, or three by
    heterodyne (beats of beats)."""
    longest = 1.02 * max(rows, cols)
    for count in PAIRS:
        pair = longest / count, longest / (count + 1)
        if frames // 4 >= LEAST_STEPS and pair[-1] >= PERIODS[0]:
            yield f"phase:steps={frames // 4},periods={pair[0]:.6g}/{pair[1]:.6g}"
    for fine in PERIODS:
        most = longest / fine
        if most < 12 or frames // 6 < LEAST_STEPS:
            continue
        numbers = most, most - 1, most - math.sqrt(most)
        periods = "/".join(f"{longest / number:.6g}" for number in sorted(numbers))
        yield f"phase:steps={frames // 6},periods={periods}"


def _codes(frames: int) -> Iterator[str]:
    for name in ("gray", "binary"):
        yield f"{name}:inverses=true,references=false"
        yield f"{name}:inverses=false"
    for step in (2, 4, 8, 16, 32):
        yield f"stripe:step={step}"


def _ladders(rows: int, cols: int, frames: int) -> Iterator[Candidate]:
    """Temporal unwrapping from a fringe that spans the surface to the finest, which gets all remaining
    steps; and the same number of steps for all."""
    for fine in PERIODS:
        for levels in (2, 3):
            steps = (frames - 2 * LEAST_STEPS * (levels - 1)) // 2
            if steps >= LEAST_STEPS and fine * 2 < min(rows, cols):
                sequence = ladder(rows, cols, fine, levels, steps)
                yield Candidate(sequence.name, sequence)
                if steps >= 2 * LEAST_STEPS:
                    even = frames // (2 * levels)
                    sequence = ladder(rows, cols, fine, levels, even, even)
                    yield Candidate(sequence.name, sequence)


def ladder(
    rows: int, cols: int, fine: float, levels: int, steps: int, coarse_steps: int = LEAST_STEPS
) -> Sequence:
    """`levels` periods per axis in geometric progression; the finest in `steps` steps, the others in
    `coarse_steps`."""
    frames: list[Frame] = []
    for axis, extent in (("u", cols), ("v", rows)):
        coarse = SPAN * extent
        for level in range(levels):
            period = coarse * (fine / coarse) ** (level / (levels - 1))
            count = steps if level == levels - 1 else coarse_steps
            frames += [
                Frame("phase", axis, period_px=period, shift=2 * math.pi * k / count) for k in range(count)
            ]
    return Sequence(
        tuple(frames), rows, cols, f"ladder: {levels} to {fine:g} px, steps {coarse_steps}/{steps}"
    )


def user_candidate(text: str, rows: int, cols: int, *, resized: bool = False) -> Candidate:
    """The candidate of 'PATTERN[@MODULE:FUNCTION]': see `user_sequence` and `user_decoder`. InputError for
    images without a decoder."""
    name, decoder = _halves(text)
    pattern = user_sequence(name, rows, cols, resized=resized)
    if decoder:
        return Candidate(text, pattern, user_decoder(decoder))
    return Candidate(text, Candidate(text, pattern).sequence)


def _halves(text: str) -> tuple[str, str]:
    """PATTERN and MODULE:FUNCTION; a path may hold an @, too."""
    pattern, _, decoder = text.rpartition("@")
    return (pattern, decoder) if pattern and re.fullmatch(r"[\w.]+:\w+", decoder) else (text, "")
