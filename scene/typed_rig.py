"""The TOML of a rig from numbers that people have: sizes, angles, distances, lens."""

import math
from dataclasses import dataclass
from typing import Any

from optolever.toml import toml_text

__all__ = ["TypedRig", "rig_toml"]


@dataclass(frozen=True, slots=True)
class TypedRig:
    """Sizes (length along x, width) and distances in mm, angles in rad, images as (rows, cols); focal: in
    pixels, focal_accuracy: its relative standard deviation, None: that of typed numbers.

    angle: of a monitor rig's line of sight with the mirror's normal; of a prism's camera face with the
    mirror. distance: from the camera to the mirror's middle. Of a monitor rig: display_distance, from the
    display's middle to the mirror's. Of a prism: display_angle, of the display's face with the mirror; bezel,
    from the mirror's edge to the display's first pixel; across, from the mirror's side y = 0 to that pixel
    (None: the display is centred); index of refraction.
    """

    mirror: tuple[float, float]
    display: tuple[int, int]
    pitch: float
    image: tuple[int, int]
    focal: float
    angle: float
    distance: float
    display_distance: float | None = None
    display_angle: float | None = None
    bezel: float = 0.0
    across: float | None = None
    index: float | None = None
    focal_accuracy: float | None = None

    @property
    def middle(self) -> tuple[float, float]:
        """Of the mirror, x and y."""
        return 0.5 * self.mirror[0], 0.5 * self.mirror[1]

    @property
    def offset_across(self) -> float:
        """From the mirror's side y = 0 to a prism display's first pixel."""
        centred = 0.5 * (self.mirror[1] - self.display[0] * self.pitch)
        return centred if self.across is None else self.across


def rig_toml(name: str, rig: TypedRig) -> str:
    """The scene as TOML. The camera looks at the mirror's middle; a monitor stands square to the reflected
    line of sight (display_distance given), or the display and the camera look through a prism's faces."""
    sine, cosine = math.sin(rig.angle), math.cos(rig.angle)
    (x, y), (rows, cols) = rig.middle, rig.display
    pattern: dict[str, Any] = {"size": [cols, rows], "pitch_mm": _digits(rig.pitch)}
    if rig.display_distance is None:
        pattern |= {
            "angle_deg": _degrees(rig.display_angle or 0.0),
            "offset_mm": [rig.bezel, _digits(rig.offset_across)],
        }
    else:  # square to the reflected line of sight, columns along y, rows downwards
        across, down, away = 0.5 * (cols - 1) * rig.pitch, 0.5 * (rows - 1) * rig.pitch, rig.display_distance
        first = x - away * sine + down * cosine, y - across, away * cosine + down * sine
        pattern |= {"origin_mm": _digits(*first), "u_axis": [0, 1, 0], "v_axis": [-cosine, 0, -sine]}
    camera: dict[str, Any] = {
        "kind": "pinhole",
        "size": [rig.image[1], rig.image[0]],
        "focal_px": _digits(rig.focal),
        "position_mm": _digits(x + rig.distance * sine, y, rig.distance * cosine),
        "look_at_mm": _digits(x, y, 0.0),
    }
    table = {"name": name, "mirror": {"size_mm": [*rig.mirror]}, "pattern": pattern, "camera": camera}
    if rig.index is not None:
        camera["face"], table["medium"] = {"angle_deg": _degrees(rig.angle)}, {"index": rig.index}
    if rig.focal_accuracy is not None:
        table["accuracy"] = {"focal": rig.focal_accuracy}
    return f"# Lengths in mm, sizes as [columns, rows].\n{toml_text(table)}"


def _degrees(angle: float) -> float:
    return float(f"{math.degrees(angle):.12g}")


def _digits(*values: float) -> float | list[float]:
    """Seven digits of a length, or of several."""
    digits = [float(f"{value:.7g}") for value in values]
    return digits[0] if len(digits) == 1 else digits
