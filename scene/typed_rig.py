"""The TOML of a rig from numbers that people have: sizes, angles, distances, lens."""

import json
import math
from dataclasses import dataclass

__all__ = ["TypedRig", "rig_toml"]


@dataclass(frozen=True, slots=True)
class TypedRig:
    """Sizes (length along x, width) and distances in mm, angles in rad, images as (rows, cols).

    angle: of a monitor rig's line of sight with the mirror's normal; of a prism's camera face with the
    mirror. distance: from the camera to the mirror's middle. Of a monitor rig: display_distance, from the
    display's middle to the mirror's. Of a prism: display_angle, of the display's face with the mirror; bezel,
    from the mirror's edge to the display's first pixel; index of refraction.
    """

    mirror: tuple[float, float]
    display: tuple[int, int]
    pitch: float
    image: tuple[int, int]
    focal: float
    pixel: float
    angle: float
    distance: float
    display_distance: float | None = None
    display_angle: float | None = None
    bezel: float = 0.0
    index: float | None = None

    @property
    def middle(self) -> tuple[float, float]:
        """Of the mirror, x and y."""
        return 0.5 * self.mirror[0], 0.5 * self.mirror[1]


def rig_toml(name: str, rig: TypedRig) -> str:
    """The scene as TOML. The camera looks at the mirror's middle; a monitor stands square to the reflected
    line of sight (display_distance given), or the display and the camera look through a prism's faces."""
    sine, cosine = math.sin(rig.angle), math.cos(rig.angle)
    camera = rig.middle[0] + rig.distance * sine, rig.middle[1], rig.distance * cosine
    (rows, cols), (image_rows, image_cols) = rig.display, rig.image
    lines = [
        "# Written by `optolever rig new`; lengths in mm, sizes as [columns, rows].",
        f"name = {json.dumps(name)}",
        "[mirror]",
        f"size_mm = {_listed(rig.mirror)}",
        "[pattern]",
        f"size = [{cols}, {rows}]",
        f"pitch_mm = {rig.pitch:.7g}",
        *(_monitor(rig, rig.display_distance) if rig.display_distance is not None else _panel(rig)),
        "[camera]",
        'kind = "pinhole"',
        f"size = [{image_cols}, {image_rows}]",
        f"focal_mm = {rig.focal:g}",
        f"pixel_pitch_mm = {rig.pixel:g}",
        f"position_mm = {_listed(camera)}",
        f"look_at_mm = {_listed((*rig.middle, 0.0))}",
    ]
    if rig.index is not None:
        lines += ["[camera.face]", f"angle_deg = {_degrees(rig.angle)}", "[medium]", f"index = {rig.index:g}"]
    return "\n".join(lines) + "\n"


def _monitor(rig: TypedRig, away: float) -> list[str]:
    """Square to the reflected line of sight, its columns along y, its rows downwards."""
    rows, cols = rig.display
    sine, cosine = math.sin(rig.angle), math.cos(rig.angle)
    across, down = 0.5 * (cols - 1) * rig.pitch, 0.5 * (rows - 1) * rig.pitch
    x, y = rig.middle
    first = x - away * sine + down * cosine, y - across, away * cosine + down * sine
    axes = [f"u_axis = {_listed((0, 1, 0))}", f"v_axis = {_listed((-cosine, 0.0, -sine), 12)}"]
    return [f"origin_mm = {_listed(first)}", *axes]


def _panel(rig: TypedRig) -> list[str]:
    """On a prism's face."""
    bezel = [f"offset_mm = {rig.bezel:g}"] if rig.bezel else []
    return [f"angle_deg = {_degrees(rig.display_angle or 0.0)}", *bezel]


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.12g}"


def _listed(values: tuple[float, ...], digits: int = 7) -> str:
    return "[" + ", ".join(f"{value:.{digits}g}" for value in values) + "]"
