"""A rig of 240 x 320 pixels at rest, prepared by a decoded capture of the independent renderer; dents."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lab.live.streams import StreamRig
from lab.live.world import BALL, World, expose, world_of
from optolever.decode import Correspondence, decode
from optolever.live import Prepared, prepare
from optolever.patterns import Sequence, sequence
from optolever.scene import Layer, Scene, load, resize

Shot = Callable[..., Any]
Truth = Callable[[Any], Any]
Dents = tuple[tuple[float, float, float, float, float], ...]
NOISE = 1.5
LAYER = Layer(0.2, 0.5, youngs_modulus_sigma_mpa=0.0)


@dataclass(frozen=True)
class Rest:
    """A rig and what was captured of it at rest."""

    scene: Scene
    world: World
    fringe: Sequence
    frames: NDArray[np.uint8]
    rest_map: Correspondence


@pytest.fixture(scope="session")
def rest() -> Rest:
    scene = replace(resize(load("prism48"), 240, 320), layer=LAYER)
    world, rng = world_of(scene), np.random.default_rng(1)
    full = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    rest_map = decode(expose(world.lights((), full), rng, NOISE), full)
    fringe = sequence("crossed", scene.pattern.rows, scene.pattern.cols, period=10.0)
    light = world.lights((), fringe)[0]
    return Rest(scene, world, fringe, expose(np.repeat(light[None], 8, 0), rng, NOISE), rest_map)


@pytest.fixture(scope="session")
def prepared(rest: Rest) -> Prepared:
    return prepare(rest.scene, rest.frames, rest.rest_map, rest.fringe)


@pytest.fixture(scope="session")
def stream(rest: Rest, prepared: Prepared) -> StreamRig:
    """The prepared rig with its renderer, whose numbers are exact."""
    return StreamRig(rest.scene, rest.world, rest.fringe, replace(prepared, error=0.0))


@pytest.fixture(scope="session")
def shot(rest: Rest) -> Callable[..., NDArray[Any]]:
    """Function of dents and a seed: the frame; noise in levels, gain of the light."""

    @cache
    def light(dents: Dents) -> NDArray[np.float32]:
        return _world(rest, dents).lights(dents, rest.fringe)[0]

    def take(dents: Dents = (), seed: int = 0, noise: float = NOISE, gain: float = 1.0) -> NDArray[Any]:
        frame: NDArray[Any] = expose(light(dents), np.random.default_rng(seed), noise, gain)
        return frame

    return take


@pytest.fixture(scope="session")
def truth(rest: Rest, stream: StreamRig) -> Callable[[Dents], NDArray[np.float64]]:
    """Function of dents: the true height in the middle of the cells, mm."""
    return cache(lambda dents: replace(stream, world=_world(rest, dents)).truth(dents))


def _world(rest: Rest, dents: Dents) -> World:
    """A half-space under balls, whose far field does not fade."""
    return replace(rest.world, fading=not any(dent[0] == BALL for dent in dents))
