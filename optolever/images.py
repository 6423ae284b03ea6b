"""Images as PNG data URIs: arrays and Matplotlib figures; samples of maps, limits of their colours."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ENOUGH = 400_000  # values for the limits of a colour scale
RESOLUTION = 110  # dots per inch of every figure


def new_figure(width: float, height: float) -> Figure:
    """An empty figure (inches), laid out by constraints, drawn without any global state."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=RESOLUTION, layout="constrained", facecolor="white")


def label_axes(axes: Axes, x: str = "", y: str = "", title: str = "", frame: bool = False) -> None:
    """Names of the axes and a title, in the sizes of a report; frame: also above and on the right."""
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.set_title(title, fontsize=10, loc="left")
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(frame)


def figure_uri(figure: Figure) -> str:
    """A figure as a PNG data URI."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return _uri(stream.getvalue())


def png_uri(image: NDArray[np.uint8]) -> str:
    """A grey (rows, cols) or RGB (rows, cols, 3) image as a PNG data URI."""
    channels = image if image.ndim == 2 else image[..., ::-1]
    return _uri(cv2.imencode(".png", np.ascontiguousarray(channels))[1].tobytes())


def thumbnail(frame: NDArray[Any], side: int) -> NDArray[np.uint8]:
    """A frame as 8 bit, at most `side` pixels on its longer side, each the mean of the pixels in it."""
    grey = (frame >> max(0, int(frame.max()).bit_length() - 8)).astype(np.uint8)
    scale = side / max(grey.shape)
    if scale >= 1:
        return np.asarray(grey)
    size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def thin(array: NDArray[Any], side: int) -> NDArray[Any]:
    """Every k-th row and column of an array, at most `side` of each: samples, never averages."""
    step = max(1, -(-max(array.shape[:2]) // side))
    return array[step // 2 :: step, step // 2 :: step]


def robust_limits(values: NDArray[Any], share: float = 0.995, symmetric: bool = False) -> tuple[float, float]:
    """Limits of a colour scale that hold this share of the finite values; (0, 1) of nothing."""
    finite = values[np.isfinite(values)]
    finite = finite[:: max(1, finite.size // _ENOUGH)]
    if not finite.size:
        return (-1.0, 1.0) if symmetric else (0.0, 1.0)
    if symmetric:
        limit = float(np.quantile(np.abs(finite), share)) or 1.0
        return -limit, limit
    low, high = (float(q) for q in np.quantile(finite, (1 - share, share)))
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _uri(data: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(data).decode("ascii")
