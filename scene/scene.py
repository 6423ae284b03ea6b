"""The scene: everything that is physically there; the same at another resolution, or of a part of it."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from optolever import InputError
from optolever.files import atomic_file, together
from optolever.toml import read_toml, toml_text

from .cameras import Camera, PinholeCamera
from .covariance import TYPED, Accuracy, Covariance
from .drawing import draw_side
from .fields import Record, changed, integer, table_of, text
from .mirror import Layer, Medium, Mirror, RestForm
from .pattern import Pattern
from .sensor import Display, Sensor

__all__ = ["FOREIGN", "Scene", "resize", "scene_window", "strided"]

#: Sections of other parts in a rig's file.
FOREIGN = ("rest", "response", "colour", "profile", "devices", "sync", "start")
_FILES = {"file", "height", "places"}  # keys there that name a file


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Record):
    """A mirror at rest, a pattern surface and a camera, all in the mirror's frame (mm).

    medium None: an ideal mirror that reflects everything; display None: light proportional to level;
    sensor None: 8 bit, linear, without noise; dent: the dent to show where none is named (`dent_from_text`);
    covariance: of the numbers that a calibration adjusted, None: not calibrated; accuracy: of the numbers
    that were typed, which counts where there is no covariance (see `rig_covariance`); None: they are exact;
    rest_form: of the mirror at rest, measured by a calibration (the anchor of a reconstruction); None: plane;
    layer: elastic, behind the mirror, for forces; None: unknown.
    """

    name: Annotated[str, text]
    mirror: Mirror
    pattern: Pattern
    camera: Camera
    medium: Medium | None = None
    display: Display | None = None
    sensor: Sensor | None = None
    dent: Annotated[str | None, text] = None
    covariance: Covariance | None = None
    accuracy: Accuracy | None = TYPED
    rest_form: RestForm | None = None
    layer: Layer | None = None

    @property
    def exact(self) -> bool:
        """Whether the scene's numbers have no errors (simulations)."""
        return self.accuracy is None and self.covariance is None

    @property
    def open_air(self) -> bool:
        """Whether neither a prism nor a camera face lies before the mirror."""
        camera = self.camera
        return isinstance(camera, PinholeCamera) and camera.face is None and self.medium is None

    def __repr__(self) -> str:
        mirror, pattern, camera = self.mirror, self.pattern, self.camera
        inside = "ideal mirror" if self.medium is None else f"in a medium of index {self.medium.index:g}"
        tall = "" if pattern.aspect == 1 else f" x {pattern.pitch * pattern.aspect:.4g}"
        cell = f"{pattern.pitch:.4g}{tall}"
        return (
            f"Scene {self.name!r}: mirror {mirror.length:g} x {mirror.width:g} mm, {inside}\n"
            f"  {type(camera).__name__} of {camera.rows} x {camera.cols} pixels\n"
            f"  pattern of {pattern.rows} x {pattern.cols} cells of {cell} mm"
        )

    def plot(self, axes: Any = None) -> Any:
        """Draw camera, mirror, pattern and rays at rest from the side (x, z in mm); the matplotlib axes."""
        camera, pattern = self.camera, self.pattern
        cols = np.linspace(0, camera.cols - 1, 9)
        starts, d = camera.rays_at(np.full(9, (camera.rows - 1) / 2), cols)
        met = starts - (starts[:, 2] / d[:, 2])[:, None] * d
        out = d * [1, 1, -1]
        u, v, _ = pattern.landing(met.T, out.T)
        right, bottom = pattern.cols - 0.5, pattern.rows - 0.5
        u_corner, v_corner = np.array([[-0.5, right, right, -0.5, -0.5], [-0.5, -0.5, bottom, bottom, -0.5]])
        landed = pattern.point(u, v)
        inside = (np.abs(2 * u + 1 - pattern.cols) <= pattern.cols) & (
            np.abs(2 * v + 1 - pattern.rows) <= pattern.rows
        )
        at = np.broadcast_to(camera.origin, starts.shape) if isinstance(camera, PinholeCamera) else starts
        return draw_side(
            self.mirror.length,
            pattern.point(u_corner, v_corner),
            np.stack([at, starts, met, landed], axis=1),
            inside & (met[:, 0] >= 0) & (met[:, 0] <= self.mirror.length),
            axes,
        )

    def save(self, path: str | Path, keep: str | Path | None = None) -> None:
        """Write the scene as TOML, to be read by `load`, a covariance as .npz next to it; absent
        parts are omitted. An existing file keeps its sections of other parts; keep: a rig's file, whose
        sections of other parts are written, too.
        """
        table = table_of(self)
        table["camera"]["kind"] = "pinhole" if isinstance(self.camera, PinholeCamera) else "telecentric"
        if self.pattern.aspect != 1:
            table["pattern"]["pitch_mm"] = [self.pattern.pitch, self.pattern.pitch * self.pattern.aspect]
        if self.accuracy is None:
            table["exact"] = True
        elif self.accuracy == TYPED:
            del table["accuracy"]
        file = Path(path)
        with together():
            if self.covariance is not None:
                beside = file.with_suffix(".calibration.npz")
                self.covariance.save(beside)
                table["calibration"] = {"covariance": beside.name}
                if self.covariance.date:
                    table["calibration"]["date"] = date.fromisoformat(self.covariance.date)
                if self.rest_form is not None:
                    table["calibration"]["rest_form_mm"] = self.rest_form.coefficients.tolist()
            others = _foreign(file) | ({} if keep is None else _foreign(Path(keep), file.parent))
            with atomic_file(path) as temporary:
                temporary.write_text(toml_text(table | others), encoding="utf-8")


def _foreign(file: Path, folder: Path | None = None) -> dict[str, Any]:
    """Sections of other parts in a file; none if it is absent, or no TOML. folder: that of the file to write,
    from where the files that they name are found, too."""
    try:
        content = read_toml(file)
    except (InputError, OSError):
        return {}
    kept = {name: content[name] for name in FOREIGN if name in content}
    if folder is None or folder.resolve() == file.parent.resolve():
        return kept
    for name, section in kept.items():
        for key in _FILES & {*section} if isinstance(section, dict) else ():
            kept[name] = kept[name] | {key: os.path.relpath(file.parent / str(section[key]), folder)}
    return kept


def resize(scene: Scene, rows: int, cols: int) -> Scene:
    """The scene with a camera of rows x cols pixels, the pattern resampled by both factors' geometric mean.

    The field of view stays: the outer edges of the camera's pixels do not move, the pattern keeps its first
    corner and covers at least what it covered. Blur stays the same in cells, so that a small scene samples
    like a big one.

    >>> small = resize(load("prism48"), 60, 80)
    >>> small.camera.rows, small.camera.cols, small.pattern.rows, small.pattern.cols
    (60, 80, 75, 75)
    """
    rows, cols = integer("rows", rows), integer("cols", cols)
    by_col, by_row = scene.camera.cols / cols, scene.camera.rows / rows
    if by_col == by_row == 1:
        return scene
    camera = _resize_camera(scene.camera, rows, cols, by_row, by_col)
    pattern = _resize_pattern(scene.pattern, math.sqrt(by_col * by_row))
    covariance = scene.covariance
    if covariance is not None:
        pitch = {"pattern.pitch": pattern.pitch / scene.pattern.pitch}
        covariance = covariance.scaled(_pixel_units(by_col, by_row) | pitch)
    return replace(scene, camera=camera, pattern=pattern, covariance=covariance)


def scene_window(scene: Scene, row: float, col: float, rows: int, cols: int) -> Scene:
    """The scene with a camera whose pixel (0, 0) is at (row, col) of its camera, fractions allowed."""
    return replace(scene, camera=_window(scene.camera, row, col, rows, cols))


def strided(scene: Scene, step: int) -> Scene:
    """The scene with a camera of every step-th row and column, from pixel (0, 0) on."""
    camera, covariance = scene.camera, scene.covariance
    values: dict[str, Any] = {"rows": -(-camera.rows // step), "cols": -(-camera.cols // step)}
    if isinstance(camera, PinholeCamera):
        values |= {"focal": camera.focal / step, "centre": camera.centre / step}
    else:
        values |= {"pitch": camera.pitch * step}
    if covariance is not None:
        covariance = covariance.scaled(_pixel_units(step, step))
    return changed(scene, camera=changed(camera, **values), covariance=covariance)


def _pixel_units(by_col: float, by_row: float) -> dict[str, float]:
    """Factors on a camera's numbers whose pixels become so many times larger."""
    pixels = {"f": 1 / by_col, "cx": 1 / by_col, "cy": 1 / by_row, "pitch_u": by_col, "pitch_v": by_row}
    return {f"camera.{name}": factor for name, factor in pixels.items()}


def _resize_camera(camera: Camera, rows: int, cols: int, by_row: float, by_col: float) -> Camera:
    by = np.array([by_col, by_row])
    if isinstance(camera, PinholeCamera):
        centre = (camera.centre + 0.5) / by - 0.5
        return replace(camera, rows=rows, cols=cols, focal=camera.focal / by, centre=centre)
    shift = 0.5 * camera.pitch * (by - 1)
    origin = camera.origin + shift[0] * camera.u_axis + shift[1] * camera.v_axis
    return replace(camera, rows=rows, cols=cols, pitch=camera.pitch * by, origin=origin)


def _resize_pattern(pattern: Pattern, by: float) -> Pattern:
    rows, cols = (max(1, math.ceil(count / by - 1e-6)) for count in (pattern.rows, pattern.cols))
    return pattern.resampled(rows, cols, 1 / by, 0.5 / by - 0.5)


def _window(camera: Camera, row: float, col: float, rows: int, cols: int) -> Camera:
    if isinstance(camera, PinholeCamera):
        return replace(camera, centre=camera.centre - np.array([col, row]), rows=rows, cols=cols)
    shift = col * camera.pitch[0] * camera.u_axis + row * camera.pitch[1] * camera.v_axis
    return replace(camera, origin=camera.origin + shift, rows=rows, cols=cols)
