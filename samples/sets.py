"""Sample data: complete sets of captures as their owners would have them, from a seed.

A camera with photon noise, a display of gamma 2.2, JPEG pictures with a camera's names, a rig whose numbers
were typed a bit wrong. What is true lies apart, in TRUTH/. Sensors are pressed by a ball, as Hertz has it
(K. L. Johnson, Contact Mechanics, 1985, equations 3.41 and 4.22 to 4.24).
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from optolever.arrays import Floats
from optolever.files import atomic_folder, write_rows
from optolever.patterns import Sequence, sequence, sequence_from_text
from optolever.projector import capture, write_description
from optolever.scene import (
    Display,
    Layer,
    Scene,
    Surface,
    adjusted,
    dent_from_text,
    load,
    parameter_values,
    resize,
    trace,
    typed_sigmas,
)

__all__ = ["SAMPLES", "Sample", "write_sample"]

TRUTH = "truth"
_GAMMA, _QUALITY, _FIRST = 2.2, 97, 4711
_OFF = 0.3  # standard deviations of typed numbers by which the rig is off
_CAPTURES = 40
_LAYER = Layer(0.2)
_CONTACTS = ("capture", "x_mm", "y_mm", "depth_mm", "radius_mm", "force_n")
_BALL = 30.0  # mm, radius of the object that presses


@dataclass(frozen=True)
class Ball:
    """A ball that presses a half-space: place of its lowest point, depth, mm."""

    x: float
    y: float
    depth: float

    @property
    def edge(self) -> float:
        """Radius of the contact, mm."""
        return math.sqrt(_BALL * self.depth)

    def force(self, layer: Layer) -> float:
        """N."""
        return 4 / 3 * layer.plane_modulus * self.edge * self.depth

    def height(self, x: Floats, y: Floats) -> Floats:
        """Of the mirror, mm."""
        away, size = np.hypot(x - self.x, y - self.y) / self.edge, self.edge**2 / _BALL
        out = np.maximum(away, 1.0)
        beyond = size / np.pi * ((2 - out**2) * np.arcsin(1 / out) + np.sqrt(out**2 - 1))
        return np.where(away < 1, self.depth - size * away**2 / 2, beyond)

    def gradient(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Of the height."""
        dx, dy = (x - self.x) / self.edge, (y - self.y) / self.edge
        away = np.hypot(dx, dy)
        out, size = np.maximum(away, 1.0), self.edge / _BALL
        beyond = 2 / np.pi * size * (np.sqrt(1 - out**-2) / out - np.arcsin(1 / out))
        share = np.where(away < 1, -size, beyond)
        return share * dx, share * dy


@dataclass(frozen=True)
class Shot:
    """Pictures of a sequence into a folder; of a mirror, pressed or not."""

    folder: str
    sequence: str
    surface: Surface
    ball: Ball | None = None


Shots = Iterator[Shot]


@dataclass(frozen=True)
class Sample:
    """preset: of the scene; size: of the camera (rows, cols); shots: of a scene and a generator, each with
    its folder, its sequence and the mirror; commands: they go on from the set's folder, {dir}; lens: numbers
    of the camera that are typed as 0; own: a sequence in mine.toml."""

    preset: str
    size: tuple[int, int]
    shots: Callable[[Scene, np.random.Generator], Shots]
    commands: tuple[str, ...]
    lens: Mapping[str, float] = field(default_factory=dict)
    own: str = ""


def _pressed(folder: str, scene: Scene, rng: np.random.Generator) -> Shot:
    x, y = rng.uniform(0.3, 0.7, 2) * [scene.mirror.length, scene.mirror.width]
    ball = Ball(round(x, 2), round(y, 2), round(rng.uniform(0.1, 0.4), 3))
    return Shot(folder, "gray+phase", Surface(ball.height, ball.gradient), ball)


def _resting(scene: Scene) -> Shots:
    flat = dent_from_text("flat", scene)
    yield from (Shot("ramp", "ramp", flat), Shot("rest", "gray+phase", flat))


def _sensor(scene: Scene, rng: np.random.Generator) -> Shots:
    yield from _resting(scene)
    yield _pressed("press", scene, rng)


def _forty(scene: Scene, rng: np.random.Generator) -> Shots:
    yield from _resting(scene)
    for number in range(1, _CAPTURES + 1):
        yield _pressed(f"press{number:02d}", scene, rng)


def _tilted(scene: Scene, a: float, b: float) -> Surface:
    x0, y0 = 0.5 * scene.mirror.length, 0.5 * scene.mirror.width
    return Surface(
        lambda x, y: a * (x - x0) + b * (y - y0),
        lambda x, y: (a + 0 * np.asarray(x), b + 0 * np.asarray(y)),
    )


def _mirror(scene: Scene, rng: np.random.Generator) -> Shots:
    yield Shot("ramp", "ramp", _tilted(scene, 0, 0))
    yield Shot("flat1", "gray+phase", _tilted(scene, 0, 0))
    for number, turn in enumerate(2 * np.pi * (np.arange(3) / 3 + rng.uniform()), 2):
        tilt = np.tan(np.radians(rng.uniform(3.2, 5.0)))
        flat = _tilted(scene, tilt * np.cos(turn), tilt * np.sin(turn))
        yield Shot(f"flat{number}", "gray+phase", flat)
    yield Shot("mirror", "gray+phase", dent_from_text("gaussian:peak=0.004,sigma=25", scene))


_RESPONSE = "optolever response {dir}/ramp {dir}/rest --scene {dir}/rig.toml"
_SENSOR = """
optolever decode {dir}/rest {dir}/press --response {dir}/rig.toml --out {dir}/c
optolever reconstruct {dir}/c/press.npz --scene {dir}/rig.toml --rest {dir}/c/rest.npz --out {dir}/h.npz
optolever report {dir}/h.npz --correspondence {dir}/c/press.npz --rest {dir}/c/rest.npz \
--scene {dir}/rig.toml --out {dir}/report
"""
_MIRROR = """
optolever calibrate --scene {dir}/rig.toml --out {dir}/calibrated.toml flat={dir}/flat1 flat={dir}/flat2 \
flat={dir}/flat3 flat={dir}/flat4
optolever camera measure {dir}/mirror --rig {dir}/calibrated.toml --out {dir}/measured
optolever form {dir}/measured/h.npz --remove tilt --aperture circle
"""
_DESIGN = """
optolever decode {dir}/rest --response {dir}/rig.toml --save-profile {dir}/rig.toml --out {dir}/c.npz
optolever design --scene {dir}/rig.toml --code gray+phase --code phase --code {dir}/mine.toml \
--out {dir}/codes.png
"""
_FORTY = """
optolever decode {dir}/rest {dir}/press* --response {dir}/rig.toml --jobs 2 --out {dir}/c
optolever reconstruct {dir}/c/press*.npz --scene {dir}/rig.toml --rest {dir}/c/rest.npz --jobs 2 --out {dir}/h
"""
_LENS = {"camera.k1": -0.08, "camera.k2": 0.02}


def _commands(text: str, rest: str = "rest") -> tuple[str, ...]:
    return _RESPONSE.replace("rest", rest), *text.strip().splitlines()


#: Sets by name.
SAMPLES = {
    "sensor": Sample("prism48", (150, 200), _sensor, _commands(_SENSOR)),
    "mirror": Sample("monitor-mirror", (128, 160), _mirror, _commands(_MIRROR, "flat1"), _LENS),
    "design": Sample("prism48", (120, 160), _sensor, _commands(_DESIGN), own="gray+phase:steps=3,period=6"),
    "forty": Sample("prism48", (120, 160), _forty, _commands(_FORTY)),
}


def write_sample(name: str, out: str | Path, seed: int = 0) -> list[str]:
    """Write the set of that name into a new folder; the commands that go on from there."""
    sample, rng = SAMPLES[name], np.random.default_rng(seed)
    typed = resize(load(sample.preset), *sample.size)
    typed = replace(typed, dent=None, layer=None if typed.medium is None else _LAYER)
    truth = replace(_as_built(typed, rng), display=Display(_GAMMA), accuracy=None)
    truth, cells = adjusted(truth, sample.lens), (typed.pattern.rows, typed.pattern.cols)
    with atomic_folder(Path(out)) as folder:
        typed.save(folder / "rig.toml")
        if sample.own:
            sequence_from_text(sample.own, *cells).save(folder / "mine.toml")
        (folder / TRUTH).mkdir()
        truth.save(folder / TRUTH / "rig.toml")
        contacts = []
        for shot in sample.shots(truth, rng):
            shown = sequence(shot.sequence, *cells)
            _pictures(folder / shot.folder, truth, shot.surface, shown, int(rng.integers(1 << 31)))
            trace(truth, shot.surface).save(folder / TRUTH / f"{shot.folder}.npz")
            if shot.ball is not None and truth.layer is not None:
                ball = shot.ball
                contacts.append((shot.folder, ball.x, ball.y, ball.depth, _BALL, ball.force(truth.layer)))
        if contacts:
            write_rows(folder / TRUTH / "contacts.csv", _CONTACTS, contacts)
    return [command.format(dir=out) for command in sample.commands]


def _as_built(typed: Scene, rng: np.random.Generator) -> Scene:
    """The rig whose numbers were typed with small errors."""
    values, sigmas = parameter_values(typed), typed_sigmas(typed)
    built = adjusted(
        typed, {name: values[name] + _OFF * sigma * rng.standard_normal() for name, sigma in sigmas.items()}
    )
    if typed.layer is None:
        return built
    stiffer = 1 + _OFF * typed.layer.relative_sigma * rng.standard_normal()
    return replace(built, layer=Layer(stiffer * typed.layer.youngs_modulus_mpa))


def _pictures(folder: Path, scene: Scene, surface: Surface, shown: Sequence, seed: int) -> None:
    """A folder of pictures as a camera names them, with the description that `show` writes."""
    folder.mkdir()
    write_description(folder / "capture.toml", shown)
    for number, frame in enumerate(
        capture(scene, surface, shown, renderer="numpy", seed=seed).frames, _FIRST
    ):
        _, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        (folder / f"DSC_{number}.JPG").write_bytes(data.tobytes())
