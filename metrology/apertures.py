"""Apertures: the part of a map that figures are of. Several of them leave what all contain.

| text | pixels |
|---|---|
| circle[:radius=R,x=X,y=Y] | in the circle; default: about the middle of the good pixels, inscribed in them |
| ellipse:a=A,b=B[,x=X,y=Y] | in the ellipse of half axes A along x, B along y |
| rectangle:width=W,height=H[,x=X,y=Y] | in the rectangle, W along x, H along y |
| MASK.png | white in an image of the camera's size |

Lengths in mm, x and y in the mirror's frame.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.ndimage

from optolever.arrays import Floats, Mask
from optolever.errors import InputError
from optolever.numbers import parsed, written
from optolever.pictures import read_mask

__all__ = ["aperture_circle", "aperture_mask", "inscribed_radius", "middle_of"]

#: Sizes of each shape, both required but for a circle's.
_SIZES = {"circle": ("radius",), "ellipse": ("a", "b"), "rectangle": ("width", "height")}


def aperture_mask(texts: Sequence[str], x: Floats, y: Floats, good: Mask) -> Mask:
    """Pixels (H, W) inside all apertures; x, y (H, W): mm; good (H, W). InputError for an unknown shape, a
    number that is no length, or an aperture without a good pixel."""
    inside = np.ones(good.shape, np.bool_)
    for text in texts:
        known = text.partition(":")[0] in _SIZES
        inside &= _shape(text, x, y, good) if known else _image(text, good.shape)
        if not (inside & good).any():
            raise InputError(
                f"aperture {text}: contains no good pixel; move or widen it, in mm from the mirror's corner"
            )
    return inside


def aperture_circle(
    texts: Sequence[str], x: Floats, y: Floats, good: Mask
) -> tuple[tuple[float, float] | None, float | None]:
    """Centre and radius (mm) of the smallest circle among apertures; None, None without one."""
    given = [_numbers(text, x, y, good) for text in texts if text.partition(":")[0] == "circle"]
    least = min(given, key=lambda each: each["radius"], default=None)
    return (None, None) if least is None else ((least["x"], least["y"]), least["radius"])


def middle_of(part: Floats, good: Mask) -> float:
    """The middle of the good pixels' range along an axis."""
    return 0.5 * float(part[good].min() + part[good].max())


def inscribed_radius(x: Floats, y: Floats, good: Mask, centre: tuple[float, float]) -> float:
    """Distance from a point to the border of the good pixels, mm; holes in them are no border."""
    filled = scipy.ndimage.binary_fill_holes(good)
    border = filled & ~scipy.ndimage.binary_erosion(filled)
    return float(np.hypot(x[border] - centre[0], y[border] - centre[1]).min())


def _numbers(text: str, x: Floats, y: Floats, good: Mask) -> dict[str, float]:
    """Sizes and centre of a shape."""
    name, _, rest = text.partition(":")
    what, known = f"aperture {text}", (*_SIZES[name], "x", "y")
    texts = written(what, rest, f"NUMBER=VALUE of {', '.join(known)}", known)
    given = {key: parsed(f"{what}: {key}", value) for key, value in texts.items()}
    given = {"x": middle_of(x, good), "y": middle_of(y, good)} | given
    if name == "circle" and "radius" not in given:
        given["radius"] = inscribed_radius(x, y, good, (given["x"], given["y"]))
    for key in _SIZES[name]:
        if not given.get(key, 0.0) > 0:
            raise InputError(f"{what}: {key} must be given, above 0 mm")
    return given


def _shape(text: str, x: Floats, y: Floats, good: Mask) -> Mask:
    given = _numbers(text, x, y, good)
    u, v = x - given["x"], y - given["y"]
    if "width" in given:
        return np.asarray((np.abs(u) <= 0.5 * given["width"]) & (np.abs(v) <= 0.5 * given["height"]))
    a, b = (given["radius"],) * 2 if "radius" in given else (given["a"], given["b"])
    return np.asarray((u / a) ** 2 + (v / b) ** 2 <= 1 + 1e-9)


def _image(text: str, shape: tuple[int, ...]) -> Mask:
    path = Path(text)
    if not path.suffix:
        raise InputError(f"aperture {text!r}: unknown, must be one of {', '.join(_SIZES)} or a mask's image")
    return read_mask(path, shape, "the height map")
