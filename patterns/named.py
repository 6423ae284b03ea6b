"""Sequences by name: gray, binary, phase, gray+phase, stripe, lattice, ..."""

import inspect
import math
from collections.abc import Callable, Iterable, Iterator
from numbers import Integral
from typing import Any

import numpy as np

from optolever.errors import InputError
from optolever.numbers import whole, written
from optolever.schema import checked

from .codes import bits_for
from .frame import Frame
from .sequence import Sequence

__all__ = ["sequence", "sequence_from_text", "sequence_names", "sequence_parameters"]

Frames = tuple[Frame, ...]
#: By how much the periods of micro phase shifting are longer than the first.
_MICRO = (0.056, 0.113, 0.181, 0.256, 0.34)
_REFERENCES = (Frame("white"), Frame("black"))
#: Steps, periods, places of a sequence at most.
_MOST = 1 << 16


def sequence_names() -> tuple[str, ...]:
    """Names that sequence() knows."""
    return tuple(_BUILDERS)


def sequence_parameters(name: str) -> dict[str, Any]:
    """Parameters of a named sequence and their defaults; None: it follows from the others."""
    return {key: value.default for key, value in _wanted(name).items()}


def _wanted(name: str) -> dict[str, inspect.Parameter]:
    """Parameters of a builder besides rows and cols. InputError for an unknown name."""
    if name not in _BUILDERS:
        raise InputError(f"sequence: name is {name!r}, known are {', '.join(_BUILDERS)}")
    return dict(list(inspect.signature(_BUILDERS[name]).parameters.items())[2:])


@checked(name=str)
def sequence(name: str, rows: int, cols: int, **params: Any) -> Sequence:
    """The named sequence for a surface of rows x cols pixels (cells).

    | name | parameters and defaults (lengths in cells) |
    |---|---|
    | gray, binary, long-run-gray | axes='uv', inverses=True, cell=1.0, references=True |
    | phase | axes='uv', steps=4, periods or counts (default: three periods, from 9/8 of the surface to 16) |
    | gray+phase | axes='uv', steps=4, period=8.0, inverses=False, cells='start' |
    | micro-phase | axes='uv', period=16.0, periods (default: five more, to a third longer) |
    | stripe | axes='uv', step=4.0, width (default: two steps) |
    | lattice | period=25.0, width (default: a fifth of the period), references=False |
    | crossed | period=16.0 |
    | ramp | count=18 |

    axes: 'uv' (both, in turns), 'u' or 'v'; inverses: each bit is followed by its inverse; references: white
    and black come first; steps: shifts of every fringe; counts: fringes on each axis, in place of periods;
    cells: Gray cells of half a period from the surface's 'start' on, or from 'half' a period before it
    (complementary Gray code: only the finest bit has edges where the phase is 0).
    InputError for an unknown name or parameter, or a value out of range.

    >>> sequence("phase", rows=480, cols=640, steps=3, periods=(64, 16)).shape
    (12, 480, 640)
    """
    wanted = _wanted(name)
    params = {key: tuple(value) if isinstance(value, Iterator) else value for key, value in params.items()}
    for key, value in params.items():
        if key not in wanted:
            raise InputError(
                f"sequence {name}: unknown parameter {key!r}, known are {', '.join(wanted) or 'none'}"
            )
        if not (value is None and wanted[key].default is None):
            _check(f"sequence {name}: {key}", value, wanted[key].annotation)
    if params.get("axes", "uv") not in ("u", "v", "uv"):
        raise InputError(f"sequence {name}: axes is {params['axes']!r}, must be 'u', 'v' or 'uv'")
    rows, cols = whole(f"sequence {name}: rows", rows), whole(f"sequence {name}: cols", cols)
    for size_name, size in (("rows", rows), ("cols", cols)):
        if not 1 <= size <= 1 << 16:
            raise InputError(f"sequence {name}: {size_name} is {size}, must be in 1..{1 << 16}")
    try:
        return Sequence(_BUILDERS[name](rows, cols, **params), rows, cols, name)
    except (TypeError, ValueError) as error:
        raise InputError(f"sequence {name}: {error}") from error


def _check(what: str, value: Any, wanted: Any) -> None:
    """InputError unless a parameter has its builder's annotated type; numbers must be finite and above 0."""
    if wanted is bool:
        if not isinstance(value, bool):
            raise InputError(f"{what} is {value!r}, must be true or false")
    elif wanted is int:
        if isinstance(value, bool) or not isinstance(value, Integral) or not 1 <= int(value) <= _MOST:
            raise InputError(f"{what} is {value!r}, must be a whole number in 1..{_MOST}")
    elif wanted is not str:
        several = "Iterable" in str(wanted) and isinstance(value, Iterable) and not isinstance(value, str)
        numbers = list(value) if several else [value]
        for number in numbers:
            is_number = isinstance(number, int | float | np.number) and not isinstance(number, bool)
            if not (is_number and 0 < number < math.inf):
                raise InputError(f"{what} is {value!r}, must be above 0 and finite")
        if not 0 < len(numbers) <= _MOST:
            raise InputError(f"{what} has {len(numbers)} values, must be 1 to {_MOST}")


def sequence_from_text(text: str, rows: int, cols: int) -> Sequence:
    """The command line's form: 'phase:steps=8,periods=9/10/11', 'gray:inverses=false,axes=u', or a .toml file
    that Sequence.save wrote for a surface of this size."""
    if text.endswith(".toml"):
        return _loaded(text, rows, cols)
    name, _, rest = text.partition(":")
    params = written(f"sequence {text!r}", rest, "name=value; several values: 16/8")
    return sequence(name.strip(), rows, cols, **{key: _parsed(value) for key, value in params.items()})


def _loaded(path: str, rows: int, cols: int) -> Sequence:
    found = Sequence.load(path)
    if (found.rows, found.cols) != (rows, cols):
        own, given = f"{found.cols} columns x {found.rows} rows", f"{cols} columns x {rows} rows"
        raise InputError(f"{path}: is for {own}, the surface has {given}")
    return found


def _parsed(text: str) -> Any:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if "/" in text:
        return tuple(_parsed(part) for part in text.split("/"))
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


def _extents(rows: int, cols: int, axes: str) -> list[tuple[str, int]]:
    return [(axis, {"u": cols, "v": rows}[axis]) for axis in axes]


def _in_turns(axes: list[list[Frames]], span: int = 1) -> Frames:
    """Frames of the axes interleaved (a bit and its inverse stay together), the longer axis first, so that
    they end together: u v, v u, ..., the order reversed after every `span`.

    Both axes have the same mean time, so that motion during the sequence adds no slope. Lag of the display
    biases neither phase nor stripe position: the preceding frame belongs to the other axis or, for an even
    number of steps, is a step less as often as a step more.
    """
    shown: list[Frame] = []
    for left in reversed(range(max(map(len, axes)))):
        for own in axes if left // span % 2 else reversed(axes):
            if left < len(own):
                shown += own[-1 - left]
    return tuple(shown)


def _code(kind: str, axis: str, extent: int, inverses: bool, cell: float, before: float = 0) -> list[Frames]:
    """Bits, most significant first, each with its inverse if asked for, of cells that begin so much before
    the surface."""
    kinds, offset = (False, True) if inverses else (False,), -before if before else None
    return [
        tuple(Frame(kind, axis, bit=bit, inverted=one, cell_px=cell, offset_px=offset) for one in kinds)
        for bit in reversed(range(bits_for(math.ceil((extent + before) / cell))))
    ]


def _coded(kind: str) -> Callable[..., Frames]:
    def build(
        rows: int,
        cols: int,
        *,
        axes: str = "uv",
        inverses: bool = True,
        cell: float = 1.0,
        references: bool = True,
    ) -> Frames:
        if not (inverses or references):
            raise InputError("inverses and references are both false, a threshold needs one of them")
        bits = [_code(kind, *each, inverses, cell) for each in _extents(rows, cols, axes)]
        return (_REFERENCES if references else ()) + _in_turns(bits)

    return build


def _fringes(axis: str, period: float, steps: int) -> list[Frames]:
    """A fringe's shifts, of an even number each as long before the middle as the opposite one after it: a
    steady motion moves the phase, and adds no ripple of half the period to it."""
    if steps < 3:
        raise InputError(f"steps is {steps}, must be at least 3")
    half = (steps + 1) // 2
    shown = (*range(half), *reversed(range(half, steps)))
    return [(Frame("phase", axis, period_px=period, shift=2 * math.pi * k / steps),) for k in shown]


def _span(steps: int) -> int:
    """Three steps have no opposite pairs that cancel a display's lag: never two in a row of the same axis."""
    return 3 if steps == 3 else 1


def _phase(
    rows: int,
    cols: int,
    *,
    axes: str = "uv",
    steps: int = 4,
    periods: float | Iterable[float] | None = None,
    counts: float | Iterable[float] | None = None,
) -> Frames:
    """Fringes of `periods` pixels, or `counts` of them on each axis.

    Default: a geometric ladder of three, from 9/8 of the surface (so that its ends differ) down to 16 px.
    """
    if periods is not None and counts is not None:
        raise InputError("periods and counts are both given, one of them says it all")
    shown: list[list[Frames]] = []
    for axis, extent in _extents(rows, cols, axes):
        if periods is not None:
            ladder = _numbers(periods)
        elif counts is not None:
            ladder = [extent / count for count in _numbers(counts)]
        else:
            ladder = _ladder(extent)
        shown.append([frame for period in ladder for frame in _fringes(axis, period, steps)])
    return _in_turns(shown, _span(steps))


def _ladder(extent: int) -> list[float]:
    coarse = 1.125 * extent
    fine = min(16.0, coarse)
    return [coarse] if coarse < 32 else [coarse, math.sqrt(coarse * fine), fine]


def _numbers(value: float | Iterable[float]) -> list[float]:
    return [float(value)] if isinstance(value, int | float) else [float(item) for item in value]


def _gray_phase(
    rows: int,
    cols: int,
    *,
    axes: str = "uv",
    steps: int = 4,
    period: float = 8.0,
    inverses: bool = False,
    cells: str = "start",
) -> Frames:
    """White, black, Gray bits of cells of half a period, then one fringe per axis.

    Half a period: the cell's centre is within a quarter period of the truth, and an edge bit read either way
    moves it by no more than another quarter, so the fringe order is right at code edges too.

    Period 8: the noise part of the error is P/(2 pi) sqrt(2/N) sigma/(B MTF(P)), which for a Gaussian blur of
    b cells is least at P = 2 pi b = 3.1 px for b = 1/2; but a camera pixel that sees w cells multiplies B by
    sinc(w / P), and defocus by exp(-2 (pi b / P)^2). At 8 px both still leave half of the contrast at w = 4.8
    or b = 1.5, the noise error is 0.0076 px for 1 level of 255 against 0.0144 px at 16 px, and with 4 steps
    the rounding of the levels to 8 bits cancels by symmetry.
    """
    if cells not in ("start", "half"):
        raise InputError(f"cells is {cells!r}, must be 'start' or 'half'")
    before = period / 2 if cells == "half" else 0.0
    shown = [
        _code("gray", axis, extent, inverses, period / 2, before) + _fringes(axis, period, steps)
        for axis, extent in _extents(rows, cols, axes)
    ]
    return _REFERENCES + _in_turns(shown, _span(steps))


def _micro_phase(
    rows: int,
    cols: int,
    *,
    axes: str = "uv",
    period: float = 16.0,
    periods: float | Iterable[float] | None = None,
) -> Frames:
    """Micro phase shifting: all fringes have similar periods, which indirect light attenuates equally.

    White and black; three steps of `period` and one each of the other `periods` (default five, to a quarter
    longer): M. Gupta, S. K. Nayar, CVPR 2012, doi:10.1109/CVPR.2012.6247753.
    """
    if periods is None:
        periods = [period * (1 + share) for share in _MICRO]
    others = _numbers(periods)

    def shown(axis: str) -> list[Frames]:
        singles = [Frame("phase", axis, period_px=other, shift=0.0) for other in others]
        return _fringes(axis, period, 3) + [(single,) for single in singles]

    return _REFERENCES + _in_turns([shown(axis) for axis in axes])


def _line(axis: str, width: float, at: float) -> Frame:
    """A stripe of a width at a place (both pattern px)."""
    at_u, at_v = (at, None) if axis == "u" else (None, at)
    return Frame("stripe", axis, width_px=width, at_u=at_u, at_v=at_v)


def _stripe(
    rows: int, cols: int, *, axes: str = "uv", step: float = 4.0, width: float | None = None
) -> Frames:
    """A line swept over each axis in steps, never one after another of the same axis; default width two
    steps: every point sees four of them."""
    width = 2 * step if width is None else width
    shown: list[list[Frames]] = []
    for axis, extent in _extents(rows, cols, axes):
        if extent / step > _MOST:
            raise InputError(f"step is {step:g}, must be at least {extent / _MOST:g} on {extent} cells")
        places = [k * step for k in range(-1, math.ceil((extent - 1) / step) + 2)]
        shown.append([(_line(axis, width, at),) for at in places])
    return _in_turns(shown, max(map(len, shown)))


def _lattice(
    rows: int, cols: int, *, period: float = 25.0, width: float | None = None, references: bool = False
) -> Frames:
    """The paper's lattice of dark lines; default 25 px (2.5 mm at 0.1 mm) with lines of a fifth of that."""
    line = Frame("lattice", period_px=period, width_px=period / 5 if width is None else width)
    return ((Frame("white"), Frame("black")) if references else ()) + (line,)


def _crossed(rows: int, cols: int, *, period: float = 16.0) -> Frames:
    return (Frame("crossed", period_px=period),)


def _ramp(rows: int, cols: int, *, count: int = 18) -> Frames:
    """Uniform frames from 0 to 255, to estimate the response."""
    if count < 2:
        raise InputError(f"count is {count}, must be at least 2")
    return tuple(Frame("uniform", level=round(255 * k / (count - 1))) for k in range(count))


_BUILDERS: dict[str, Callable[..., Frames]] = {
    "gray": _coded("gray"),
    "binary": _coded("binary"),
    "long-run-gray": _coded("long-run-gray"),
    "phase": _phase,
    "gray+phase": _gray_phase,
    "micro-phase": _micro_phase,
    "stripe": _stripe,
    "lattice": _lattice,
    "crossed": _crossed,
    "ramp": _ramp,
}
