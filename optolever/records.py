"""What records have in common: equality of arrays, a few lines that say what they hold, a plot of maps."""

import base64
import html
import io
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "LOG", "Axes", "Comparable", "Progress", "default_style", "flag_line", "logged", "plot_maps", "silent",
    "span",
]  # fmt: skip

#: What the package does, for whoever listens: logging.getLogger("optolever").
LOG = logging.getLogger("optolever")
LOG.addHandler(logging.NullHandler())

#: Matplotlib's axes, one per map.
Axes = NDArray[np.object_]
#: Called with what is being done, how many steps are done, and of how many.
Progress = Callable[[str, int, int], None]


@contextmanager
def logged(what: str) -> Iterator[None]:
    """Tell the logger what was done, and how long it took."""
    start = time.perf_counter()
    yield
    LOG.info("%s: %.3f s", what, time.perf_counter() - start)


def silent(text: str, done: int, total: int) -> None:
    """Progress that nobody watches."""


class Comparable:
    """Equality of dataclasses that hold arrays: all fields equal, NaN equal to NaN; never an error."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_same(getattr(self, field.name), getattr(other, field.name)) for field in fields(self))  # type: ignore[arg-type]

    def _repr_html_(self) -> str:
        """For notebooks: the lines of repr(), and the maps as a picture where the record draws them."""
        lines = f"<pre>{html.escape(repr(self))}</pre>"
        draw = getattr(self, "plot", None)
        if draw is None:
            return lines
        import matplotlib.pyplot as plt

        figure, image = draw().flat[0].figure, io.BytesIO()
        figure.savefig(image, format="png", dpi=60)
        plt.close(figure)
        picture = base64.b64encode(image.getvalue()).decode("ascii")
        return f'{lines}<img alt="maps" src="data:image/png;base64,{picture}">'


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        one, other = np.asarray(one), np.asarray(other)
        return bool(np.array_equal(one, other, equal_nan=one.dtype.kind == other.dtype.kind == "f"))
    return bool(one == other) or (one != one and other != other)


def span(values: ArrayLike, where: ArrayLike | bool = True) -> str:
    """Smallest to largest of the finite values where `where` holds."""
    array = np.asarray(values)
    known = array[np.isfinite(array) & where]
    return f"{known.min():.5g} to {known.max():.5g}" if known.size else "nowhere known"


def flag_line(flags: NDArray[np.unsignedinteger[Any]], names: Mapping[int, str]) -> str:
    """Share of the pixels that each flag is on, those of none left out."""
    shares = {name: float((flags & bit != 0).mean()) for bit, name in names.items() if flags.size}
    told = [f"{name.lower()} {100 * share:.2g} %" for name, share in shares.items() if share > 0]
    return "flags: " + (", ".join(told) or "none")


@contextmanager
def default_style() -> Iterator[None]:
    """Matplotlib's own defaults, for pictures of the program: a user's matplotlibrc (text.usetex, fonts) is
    for the user's."""
    import matplotlib

    with matplotlib.rc_context(matplotlib.rcParamsDefault):
        yield


def plot_maps(maps: Mapping[str, ArrayLike], axes: Any = None) -> Axes:
    """Draw maps (H, W) by their titles, side by side, each with a colour bar; axes: to draw on, one per map.

    Needs matplotlib, which is imported here.
    """
    import matplotlib.pyplot as plt

    if axes is None:
        _, axes = plt.subplots(
            1, len(maps), figsize=(4.8 * len(maps), 4.2), squeeze=False, layout="constrained"
        )
    drawn = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()[: len(maps)]
    for (title, values), ax in zip(maps.items(), drawn, strict=True):
        image = ax.imshow(np.asarray(values), interpolation="nearest")
        ax.set_title(title)
        ax.figure.colorbar(image, ax=ax, shrink=0.8)
    return drawn
