"""What reports show of a run's input: flags, correspondence, frames."""

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.patterns import Frame
from optolever.projector import Capture
from optolever.reconstruct import HeightMap

from .flag_words import FlagRow, flag_index, flag_rows
from .images import png_uri, robust_limits, thumbnail
from .maps import Panel, camera_figure, flags_figure

__all__ = ["correspondence_picture", "flags_table", "frame_pairs", "frame_words"]

Array = NDArray[np.float64]
THUMBNAIL = 150  # pixels


def flags_table(height: HeightMap) -> tuple[list[FlagRow], str]:
    """Counts of every reason, and a map of them as the camera sees it."""
    flags = np.asarray(height.flags)
    rows = flag_rows(flags)
    return rows, flags_figure(flag_index(flags, rows), [row.colour for row in rows])


def correspondence_picture(seen: Correspondence) -> str:
    """Maps of u and v, and of what is left of them without their best plane: the lever's deflection."""
    panels = []
    for letter, values, what in (("u", seen.u, "pattern column"), ("v", seen.v, "pattern row")):
        known = np.where(seen.good, values, np.nan)
        bent = known - best_plane(known)
        limits = robust_limits(bent, symmetric=True)
        panels.append(Panel(known, f"{letter}: {what}", f"{letter} [px]"))
        panels.append(Panel(bent, f"{letter} minus its best plane", "deflection [px]", "RdBu_r", limits))
    return camera_figure(panels)


def frame_pairs(capture: Capture) -> list[dict[str, str]]:
    """Every frame as it was shown and as the camera saw it, in small, with a few words."""
    return [
        {
            "shown": png_uri(thumbnail(capture.sequence.render_frame(index), THUMBNAIL)),
            "seen": png_uri(thumbnail(capture.frames[index], THUMBNAIL)),
            "name": f"{index + 1}. {frame_words(frame)}",
        }
        for index, frame in enumerate(capture.sequence.frames)
    ]


def frame_words(frame: Frame) -> str:
    """A frame in a few words."""
    words = [frame.kind if frame.axis is None else f"{frame.kind} on {frame.axis}"]
    if frame.bit is not None:
        words.append(f"bit {frame.bit}")
    if frame.inverted:
        words.append("inverted")
    if frame.period_px is not None:
        words.append(f"period {frame.period_px:.4g} px")
    if frame.shift is not None:
        words.append(f"shift {np.degrees(frame.shift):.0f}°")
    return ", ".join(words)


def best_plane(values: Array) -> Array:
    """The least-squares plane through the finite values, on every pixel."""
    row, col = np.meshgrid(*(np.linspace(-1, 1, n) for n in values.shape), indexing="ij")
    use = np.isfinite(values)
    if not use.any():
        return np.zeros(values.shape)
    basis = np.stack([np.ones(int(use.sum())), row[use], col[use]])
    a, b, c = np.linalg.lstsq(basis @ basis.T, basis @ values[use], rcond=None)[0]
    return np.asarray(a + b * row + c * col, dtype=np.float64)
