"""Wrong captures: 31 kinds of faults of frames, of their order and of their description."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Decoder
from optolever.errors import InputError
from optolever.patterns import Frame, Sequence

__all__ = ["Fault", "faults"]

#: Name, frames, description, whether frames of the code can show it.
Fault = tuple[str, NDArray[Any], Sequence, bool]


def faults(frames: NDArray[Any], shown: Sequence, rng: np.random.Generator) -> Iterator[Fault]:
    yield from _orders(frames, shown, rng)
    yield from _pictures(frames, shown)
    for name, described, knowable in _descriptions(shown):
        try:
            Decoder(described)
        except InputError:
            continue
        yield name, frames, described, knowable


def _orders(f: NDArray[Any], shown: Sequence, rng: np.random.Generator) -> Iterator[Fault]:
    count, dark = len(f), f.min(axis=0)
    same = np.arange(count)
    k = int(rng.integers(count // 4, 3 * count // 4))
    yield "a copy first", f[np.r_[0, 0 : count - 1]], shown, True
    yield "a dark picture first", np.concatenate([dark[None], f[:-1]]), shown, True
    yield "a white picture first", np.concatenate([f.max(axis=0)[None], f[:-1]]), shown, True
    yield "a dark picture amid", np.concatenate([f[:k], dark[None], f[k:-1]]), shown, True
    yield "the first missing", np.concatenate([f[1:], f[-1:]]), shown, True
    yield "one missing", np.concatenate([f[:k], f[k + 1 :], f[-1:]]), shown, True
    yield "one twice", f[np.r_[0 : k + 1, k : count - 1]], shown, True
    yield "one repeats the one before", f[np.r_[0:k, k - 1, k + 1 : count]], shown, True
    coded = [i for i, frame in enumerate(shown.frames) if frame.axis]
    i, j = rng.choice(coded, 2, replace=False)
    swapped = same.copy()
    swapped[[i, j]] = j, i
    yield "two swapped", f[swapped], shown, True
    yield "reversed", f[::-1], shown, True
    yield "alphabetical", f[sorted(range(count), key=str)], shown, True
    yield "shuffled", f[rng.permutation(count)], shown, True
    half = 0.5 * f.astype(float) + 0.5 * f[np.r_[0, 0 : count - 1]]
    yield "half of each before", np.rint(half).astype(f.dtype), shown, True
    torn, middle = f.copy(), f.shape[1] // 2
    torn[1:, middle:] = f[:-1, middle:]
    yield "torn", torn, shown, True


def _pictures(f: NDArray[Any], shown: Sequence) -> Iterator[Fault]:
    """Of a fringe's step, of bits."""
    dark, bright = f.min(axis=0), f.max(axis=0)

    def other(k: int, picture: NDArray[Any]) -> NDArray[Any]:
        out = f.copy()
        out[k] = np.rint(picture).astype(f.dtype)
        return out

    steps = [i for i, frame in enumerate(shown.frames) if frame.kind == "phase"]
    if steps:
        first = shown.frames[steps[0]]
        own = [
            i
            for i in steps
            if (shown.frames[i].axis, shown.frames[i].period_px) == (first.axis, first.period_px)
        ]
        swapped = f.copy()
        swapped[own[:2]] = f[own[1::-1]]
        yield "two steps swapped", swapped, shown, True
        yield "a step black", other(own[1], dark), shown, True
        yield "a step white", other(own[1], bright), shown, True
        yield "a step half bright", other(own[1], dark + 0.5 * (f[own[1]].astype(float) - dark)), shown, True
    bits = [i for i, frame in enumerate(shown.frames) if frame.bit is not None]
    if bits:
        axis = shown.frames[bits[0]].axis
        of_axis = [i for i in bits if shown.frames[i].axis == axis]
        fine, coarse = (pick(of_axis, key=lambda i: shown.frames[i].bit or 0) for pick in (min, max))
        amid = of_axis[len(of_axis) // 2]
        for name, k in (("finest", fine), ("middle", amid), ("coarsest", coarse)):
            yield f"{name} bit black", other(k, dark), shown, name != "coarsest"
            yield f"{name} bit white", other(k, bright), shown, name != "coarsest"
        yield "a bit half bright", other(amid, dark + 0.5 * (f[amid].astype(float) - dark)), shown, True


def _descriptions(shown: Sequence) -> Iterator[tuple[str, Sequence, bool]]:
    fringes = any(frame.kind == "phase" for frame in shown.frames)
    bits = [frame for frame in shown.frames if frame.bit is not None]

    def of(kind: Callable[[Frame], bool], change: Callable[[Frame], dict[str, Any]]) -> Sequence:
        frames = tuple(replace(frame, **change(frame)) if kind(frame) else frame for frame in shown.frames)
        return replace(shown, frames=frames)

    def phase(frame: Frame) -> bool:
        return frame.kind == "phase"

    def bit(frame: Frame) -> bool:
        return frame.bit is not None

    if fringes:
        yield "sine for cosine", of(phase, lambda f: {"shift": (f.shift or 0.0) - np.pi / 2}), bool(bits)
        yield "shifts of other sign", of(phase, lambda f: {"shift": -(f.shift or 0.0)}), bool(bits)
        yield "periods x .9", of(phase, lambda f: {"period_px": 0.9 * (f.period_px or 1.0)}), bool(bits)
    if bits:
        last = {axis: max(f.bit or 0 for f in bits if f.axis == axis) for axis in {f.axis for f in bits}}
        cell = bits[0].cell_px
        yield "cells x .75", of(bit, lambda f: {"cell_px": 0.75 * f.cell_px}), fringes
        yield "cells x .5", of(bit, lambda f: {"cell_px": 0.5 * f.cell_px}), fringes
        yield "offset half a cell", of(bit, lambda f: {"offset_px": (f.offset_px or 0.0) + cell / 2}), fringes
        yield "offset 100", of(bit, lambda f: {"offset_px": (f.offset_px or 0.0) + 100}), fringes
        yield "bits inverted", of(bit, lambda f: {"inverted": not f.inverted}), True
        yield "bits reversed", of(bit, lambda f: {"bit": last[f.axis] - (f.bit or 0)}), True
        yield "binary for Gray", of(bit, lambda f: {"kind": {"gray": "binary"}.get(f.kind, "gray")}), True
    if {f.axis for f in shown.frames} >= {"u", "v"}:
        both = of(lambda f: bool(f.axis), lambda f: {"axis": "uv".replace(f.axis or "", "")})
        yield "u and v exchanged", both, False
