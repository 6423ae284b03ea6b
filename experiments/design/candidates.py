"""What could be shown within a number of frames: every family of codes with the parameters that fill the
budget, and what a user brings: a Python callable, a folder of images with what they encode, or a name.
"""

import importlib
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Frame, Sequence, bits_for, sequence_from_text, sequence_names
from optolever.pictures import read_grey
from optolever.toml import read_toml

#: Periods whose half is a whole number of cells: a Gray code cannot show others exactly.
EVEN_PERIODS = (4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)
PERIODS = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)
#: Numbers of fringes of two periods that are unambiguous together, one more each.
PAIRS = (5, 8, 12, 15, 18, 22, 27, 33, 40, 50, 60, 75, 90, 110)
LEAST_STEPS = 3
SPAN = 1.125  # of the surface: a coarse period whose ends differ
#: Sequences that no dense, absolute map can be decoded from on their own.
NOT_DENSE = ("lattice", "crossed", "ramp")
SLACK = 1  # grey levels by which an image may differ from its description


@dataclass(frozen=True, slots=True)
class Candidate:
    """A sequence and how it is called; text of a named sequence is what the command line takes."""

    text: str
    sequence: Sequence


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


def _add(found: dict[str, Candidate], text: str, rows: int, cols: int, frames: int) -> None:
    try:
        sequence = sequence_from_text(text, rows, cols)
    except InputError:  # a surface too small or too large for this code
        return
    if len(sequence) <= frames:
        found.setdefault(text, Candidate(text, sequence))


def _gray_phase(rows: int, cols: int, frames: int) -> Iterator[str]:
    """White, black, Gray bits of cells of half a period, and as many steps as are left."""
    for period in EVEN_PERIODS:
        bits = sum(bits_for(math.ceil(extent / (period / 2))) for extent in (rows, cols))
        steps = (frames - 2 - bits) // 2
        if steps >= LEAST_STEPS:
            yield f"gray+phase:period={period:g},steps={steps}"


def _together(rows: int, cols: int, frames: int) -> Iterator[str]:
    """Periods that are unambiguous only together: two whose numbers of fringes differ by one, three by
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
    for name in ("gray", "binary", "xor-gray"):
        yield f"{name}:inverses=true,references=false"
        yield f"{name}:inverses=false"
    for step in (2, 4, 8, 16, 32):
        yield f"stripe:step={step}"


def _ladders(rows: int, cols: int, frames: int) -> Iterator[Candidate]:
    """Fringes from one that spans the surface down to the finest, all steps that are left on the finest."""
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
    """A geometric ladder of `levels` periods per axis, the finest in `steps` steps, the others in fewer."""
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


def user_candidate(text: str, rows: int, cols: int) -> Candidate:
    """The candidate behind 'module:function', a folder, a .toml file or the name of a sequence.

    The module lies in the working folder or is installed. The function is called with rows and cols and
    returns a Sequence of that size. A folder holds `sequence.toml` as Sequence.save_png writes it, or
    `coordinates.toml`:

        [[frames]]
        file = "a.png"
        axis = "u"        # the coordinate along which the image varies

    Each image has the size of the pattern and varies along its axis alone; it becomes a frame of free levels.
    InputError names what is wrong.
    """
    if text.partition(":")[0] in sequence_names() or text.endswith(".toml"):
        return Candidate(text, sequence_from_text(text, rows, cols))
    if Path(text).is_dir():
        return Candidate(text, _from_folder(Path(text), rows, cols))
    return Candidate(text, _from_callable(text, rows, cols))


def _from_callable(text: str, rows: int, cols: int) -> Sequence:
    module, colon, name = text.partition(":")
    if not colon:
        raise InputError(
            f"pattern {text!r}: is no folder, no .toml, no module:function and no known sequence"
        )
    before = list(sys.path)
    sys.path.append(str(Path.cwd()))  # last, so that it hides no other module
    try:
        function = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"pattern {text!r}: cannot be imported ({error})") from error
    else:
        try:
            found = function(rows, cols)
        except Exception as error:  # whatever a user's function raises is a finding about that function
            raise InputError(f"pattern {text!r}: raises {type(error).__name__}: {error}") from error
    finally:
        sys.path[:] = before
    if not isinstance(found, Sequence):
        raise InputError(f"pattern {text!r}: returns {type(found).__name__}, must be a Sequence")
    if (found.rows, found.cols) != (rows, cols):
        raise InputError(f"pattern {text!r}: is {found.rows}x{found.cols} cells, must be {rows}x{cols}")
    return found


def _from_folder(folder: Path, rows: int, cols: int) -> Sequence:
    if (folder / "sequence.toml").is_file():
        return _described(folder, rows, cols)
    path = folder / "coordinates.toml"
    if not path.is_file():
        raise InputError(f"{folder}: holds neither sequence.toml nor coordinates.toml")
    tables = read_toml(path).get("frames")
    if not isinstance(tables, list) or not tables:
        raise InputError(f"{path}: frames is missing, must be at least one [[frames]] table")
    frames = tuple(_frame(path, i, table, rows, cols) for i, table in enumerate(tables))
    return Sequence(frames, rows, cols, folder.name)


def _described(folder: Path, rows: int, cols: int) -> Sequence:
    """sequence.toml and images that show what it says."""
    found = sequence_from_text(str(folder / "sequence.toml"), rows, cols)
    for index in range(len(found)):
        path = folder / f"{index:03d}.png"
        image = _image(path, rows, cols)
        if np.abs(image.astype(np.int16) - found.render_frame(index)).max() > SLACK:
            raise InputError(f"{path}: is not the image that sequence.toml describes as frame {index}")
    return found


def _frame(path: Path, index: int, table: Any, rows: int, cols: int) -> Frame:
    where = f"{path}: frames[{index}]"
    if not isinstance(table, dict) or set(table) - {"file", "axis"}:
        raise InputError(f"{where}: is {table!r:.60}, must hold file and axis")
    axis, name = table.get("axis"), table.get("file")
    if axis not in ("u", "v", None) or not isinstance(name, str):
        raise InputError(f"{where}: file {name!r} and axis {axis!r}, must be text and 'u' or 'v'")
    image = _image(path.parent / name, rows, cols)
    if axis is None:
        level = int(image.flat[0])
        if np.ptp(image) > SLACK:
            raise InputError(f"{where}: {name} varies, axis must say along what")
        return {255: Frame("white"), 0: Frame("black")}.get(level, Frame("uniform", level=level))
    along = image if axis == "u" else image.T
    if np.ptp(along, axis=0).max() > SLACK:
        raise InputError(f"{where}: {name} varies across {axis} too, must vary along it alone")
    return Frame("levels", axis, levels=tuple(int(level) for level in along[0]))


def _image(path: Path, rows: int, cols: int) -> NDArray[np.uint8]:
    image = read_grey(path)
    if image.shape != (rows, cols):
        raise InputError(
            f"{path}: is {image.shape[0]}x{image.shape[1]} pixels, the pattern has {rows}x{cols}"
        )
    return np.asarray(image, np.uint8)
