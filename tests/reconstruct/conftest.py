"""Exact correspondences of small scenes, made once."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from lab.live.world import world_of
from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap, exact_correspondence
from optolever.scene import Scene, Trace, dent_from_text, load, resize, trace

Exact = tuple[Scene, Trace, Correspondence]


def correspondence_of(
    truth: Trace, sigma: float = 0.02, noise: float = 0.0, seed: int | np.random.Generator = 0
) -> Correspondence:
    """What a decoder would make of a trace: u and v with Gaussian noise,
    OFF_PATTERN where nothing is seen.
    """
    error = noise * np.random.default_rng(seed).standard_normal((2, *truth.u.shape))
    return replace(exact_correspondence(truth, sigma), u=truth.u + error[0], v=truth.v + error[1])


def pressed_half_space(
    scene: Scene, dents: Any, noise: float, seed: int
) -> tuple[Correspondence, np.ndarray]:
    """What is seen of an exact half-space under balls, and its height; no dents: at rest."""
    u, v, z, *_ = replace(world_of(scene), fading=False).truth(dents)
    rng, sigma, level = np.random.default_rng(seed), np.full(u.shape, noise), np.full(u.shape, 100.0)
    off = (u < 0) | (u > scene.pattern.cols - 1) | (v < 0) | (v > scene.pattern.rows - 1)
    u, v = (part + noise * rng.standard_normal(u.shape) for part in (u, v))
    return Correspondence(u, v, sigma, sigma.copy(), off.astype(np.uint16), level, level.copy()), z


def scores(height: HeightMap, truth: Trace) -> np.ndarray:
    """Errors over sigma, (H, W); NaN where a flag stands, and nowhere else."""
    found = np.where(height.good, (height.z - truth.z) / height.sigma, np.nan)
    assert np.isfinite(found[height.good]).all()
    return np.asarray(found)


def rms_score(*found: np.ndarray) -> float:
    """Of scores that are known."""
    return float(np.sqrt(np.nanmean(np.square(np.concatenate([np.ravel(each) for each in found])))))


@lru_cache(maxsize=32)
def exact_case(preset: str, dent: str, rows: int, cols: int) -> Exact:
    """A preset at another size, its trace under a dent, and the exact correspondence."""
    scene = resize(load(preset, exact=True), rows, cols)
    truth = trace(scene, dent_from_text(dent, scene))
    return scene, truth, correspondence_of(truth)


@pytest.fixture(scope="session")
def exact() -> Callable[[str, str, int, int], Exact]:
    return exact_case


@pytest.fixture(scope="session")
def noisy() -> Callable[..., Correspondence]:
    return correspondence_of


@pytest.fixture(scope="session")
def cut() -> Callable[[Correspondence, np.ndarray], Correspondence]:
    """Flag everything outside a mask as dark."""

    def flagged(correspondence: Correspondence, keep: np.ndarray) -> Correspondence:
        flags = np.where(keep, correspondence.flags, correspondence.flags | 1).astype(np.uint16)
        return replace(correspondence, flags=flags)

    return flagged
