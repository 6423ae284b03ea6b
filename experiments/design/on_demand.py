"""A sensor that shows any frame on demand: what an adaptive measurement asks for, and a virtual one."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Frame, Sequence
from optolever.projector import capture
from optolever.scene import Scene, Surface

__all__ = ["OnDemand", "VirtualOnDemand"]


class OnDemand(Protocol):
    """Shows frames that nobody knew before, and brings their images."""

    def show(self, frames: tuple[Frame, ...]) -> NDArray[Any]:
        """Images (n, H, W) of the frames, in their order."""


class VirtualOnDemand:
    """The virtual sensor as such a source; every frame that is shown has noise of its own."""

    def __init__(
        self, scene: Scene, surface: Surface, *, noise: float, seed: int = 0, renderer: str = "auto"
    ) -> None:
        self._scene, self._surface = scene, surface
        self._noise, self._seed, self._renderer = noise, seed, renderer
        self.shown = 0

    def show(self, frames: tuple[Frame, ...]) -> NDArray[Any]:
        """Images (n, H, W) of the frames, in their order."""
        pattern = self._scene.pattern
        sequence = Sequence(frames, pattern.rows, pattern.cols)
        seed = int(np.random.SeedSequence([self._seed, self.shown]).generate_state(1)[0])
        self.shown += len(frames)
        seen = capture(
            self._scene, self._surface, sequence, noise=self._noise, seed=seed, renderer=self._renderer
        )
        return seen.frames
