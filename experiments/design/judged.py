"""The scenes on which choices are judged: ten that stand, and as many as wanted drawn by number."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from optolever.scene import Scene, load, resize

from ..drawn import between, dent_params
from .sensor_sweep import varied

__all__ = ["CASES", "Case", "drawn_cases"]


@dataclass(frozen=True, slots=True)
class Case:
    """A scene to choose for: preset, what is varied (see varied), dent, blur in cells, noise, frames."""

    preset: str
    dent: str
    blur: float
    noise: float
    frames: int
    changes: tuple[tuple[str, float], ...] = ()

    def scene(self, pixels: int) -> Scene:
        """The scene, with `pixels` along the camera's shorter side."""
        scene = load(self.preset)
        for name, value in self.changes:
            scene = varied(scene, name, value)
        by = pixels / min(scene.camera.rows, scene.camera.cols)
        scene = resize(scene, round(scene.camera.rows * by), round(scene.camera.cols * by))
        return replace(scene, pattern=replace(scene.pattern, blur_px=self.blur))

    @property
    def name(self) -> str:
        """The case in a few words."""
        changes = "".join(f" {name} {value:g}" for name, value in self.changes)
        limits = f"blur {self.blur:g}, noise {self.noise:g}, {self.frames} frames"
        return f"{self.preset}{changes}, {self.dent}, {limits}"


#: Ten scenes; no number was fitted to them.
CASES = (
    Case("prism48", "ridge:peak=0.1,sigma=5", 0.5, 0.5, 20, (("angle", 50.0),)),
    Case("prism48", "gaussian:peak=0.1,sigma=10", 1.0, 1.0, 28, (("index", 1.49),)),
    Case("prism48", "flat", 0.6, 3.0, 24, (("distance", 5.0),)),
    Case("prism48", "raised-cosine:peak=0.2", 1.5, 2.0, 32, (("angle", 46.0),)),
    Case("paper-simulation", "gaussian:peak=0.6,sigma=25", 0.7, 2.0, 18),
    Case("paper-simulation", "ball:peak=0.4", 0.4, 1.0, 16, (("pattern", 0.7),)),
    Case("paper-simulation", "rounded-needle:peak=0.3", 2.0, 1.0, 36),
    Case("monitor-mirror", "gaussian:peak=0.05,sigma=15", 0.5, 1.0, 20),
    Case("monitor-mirror", "flat", 1.2, 4.0, 40, (("distance", 100.0),)),
    Case("monitor-mirror", "ridge:peak=0.05,sigma=12", 0.8, 0.5, 14, (("pattern", 1.5),)),
)

#: What is varied on each preset, and between what.
_CHANGES = {
    "prism48": {"angle": (46.0, 52.0), "index": (1.4, 1.6), "distance": (1.0, 8.0), "pattern": (0.6, 1.5)},
    "paper-simulation": {"index": (1.4, 1.6), "distance": (1.0, 15.0), "pattern": (0.6, 1.5)},
    "paper-prototype": {"index": (1.42, 1.6), "distance": (0.5, 5.0), "pattern": (0.4, 1.0)},
    "monitor-mirror": {"distance": (20.0, 200.0), "pattern": (0.6, 1.5)},
}
#: Dents that are drawn.
_DENTS = ("flat", "raised-cosine", "gaussian", "ridge", "rounded-needle", "ball")


def drawn_cases(count: int, first: int = 0) -> Iterator[Case]:
    """`count` cases that nobody has thought of; a number's case is always the same."""
    for number in range(first, first + count):
        yield _drawn(np.random.default_rng([1999, number]))


def _drawn(rng: np.random.Generator) -> Case:
    preset = str(rng.choice(list(_CHANGES)))
    changes: tuple[tuple[str, float], ...] = ()
    if rng.random() < 0.7:
        name = str(rng.choice(list(_CHANGES[preset])))
        changes = ((name, _round(rng.uniform(*_CHANGES[preset][name]))),)
    form = str(rng.choice(_DENTS))
    pressed = _dent(form, load(preset), between(rng, 0.1, 0.7), between(rng, 0.5, 1.5))
    blur, noise = _round(rng.uniform(0.3, 2)), _round(between(rng, 0.4, 4))
    return Case(preset, pressed, blur, noise, int(rng.integers(14, 41)), changes)


def _dent(form: str, scene: Scene, depth: float, width: float) -> str:
    """A dent of a form as on the command line; depth, width: in units of the usual one's."""
    if form == "flat":
        return form
    params = dent_params(form, scene, depth, width)
    return f"{form}:" + ",".join(f"{name}={_round(value):g}" for name, value in params.items())


def _round(value: float) -> float:
    """To two digits: names stay short."""
    return float(f"{value:.2g}")
