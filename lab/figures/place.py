"""A dented mirror in front of a camera: its truth, and the correspondence of a perfect decoder."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from optolever.decode import Correspondence
from optolever.experiments.arrays import Mask
from optolever.reconstruct import PixelAnchor, exact_correspondence
from optolever.scene import Scene, Surface, Trace, dent_from_text, load, resize, trace

Dent = str | Callable[[Scene], Surface] | None
EXACT_SIGMA = 0.01  # px, of exact correspondences: solvers weigh by ratios of sigmas only
USUAL = "raised-cosine"


@dataclass(frozen=True, slots=True)
class Place:
    """A dented mirror: scene, shape, and the traced truth of each pixel; dent: name of the shape."""

    scene: Scene
    surface: Surface
    truth: Trace
    dent: str

    @classmethod
    def of(cls, scene: Scene | str | Path, dent: Dent = None, size: tuple[int, int] | None = None) -> "Place":
        """The mirror of a scene, preset or TOML file, traced; size (rows, cols) resamples the camera.

        dent: as on the command line, or a function of the scene; none: the scene's, else a raised cosine.
        InputError for unknown names.
        """
        known = resolve(scene, size)
        if callable(dent):
            name, surface = getattr(dent, "__name__", ""), dent(known)
        else:
            name = dent or known.dent or USUAL
            surface = dent_from_text(name, known)
        return cls(known, surface, trace(known, surface), name)

    @property
    def peak(self) -> float:
        """Largest visible height or depth, mm."""
        return float(np.max(np.abs(self.truth.z[self.truth.visible])))


def resolve(scene: Scene | str | Path, size: tuple[int, int] | None = None) -> Scene:
    """A scene, or the one of a preset or TOML file, resampled to size (rows, cols) if one is given."""
    known = scene if isinstance(scene, Scene) else load(scene, exact=True)
    return known if size is None else resize(known, *size)


def exact(
    truth: Trace, where: Mask | None = None, *, noise: float = 0.0, rng: np.random.Generator | None = None
) -> Correspondence:
    """The true correspondence, flagged where a pixel views no pattern and outside `where` (H, W).

    noise: rms px of white noise, drawn by rng and stated as sigma; 0: EXACT_SIGMA is stated.
    """
    seen = truth if where is None else replace(truth, visible=truth.visible & where)
    found = exact_correspondence(seen, noise or EXACT_SIGMA)
    if rng is None:
        return found
    u, v = (part + noise * rng.standard_normal(part.shape) for part in (truth.u, truth.v))
    return replace(found, u=u, v=v)


def middle_anchor(truth: Trace) -> PixelAnchor:
    """The true height of the pixel in the middle."""
    row, col = (size // 2 for size in truth.u.shape)
    return PixelAnchor(float(row), float(col), float(truth.z[row, col]))
