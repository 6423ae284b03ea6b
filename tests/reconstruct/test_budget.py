"""The uncertainty budget against solves of rigs that are wrong in one number, and of anchors that are."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from lab.calibration.typed import behind_glass
from optolever.reconstruct import (
    NOISE,
    TOTAL,
    HeightMap,
    PointAnchor,
    budget,
    exact_correspondence,
    reconstruct,
)
from optolever.scene import (
    Accuracy,
    Covariance,
    Scene,
    adjusted,
    dent,
    dent_from_text,
    load,
    parameter_values,
    resize,
    trace,
)

SIGMAS = {"camera.ry": 1e-4, "pattern.z": 0.02}  # rad, mm


@pytest.fixture(scope="module")
def rig() -> Scene:
    small = resize(load("prism48", exact=True), 72, 96)
    parts = np.stack(
        [np.diag([s**2 if k == j else 0 for j in range(2)]) for k, s in enumerate(SIGMAS.values())]
    )
    known = Covariance(tuple(SIGMAS), parts.sum(axis=0), sources=("camera", "pattern"), parts=parts)
    return replace(small, covariance=known)


def measured(
    rig: Scene, name: str, anchor: PointAnchor | None = None, used: Scene | None = None, **numbers: float
) -> HeightMap:
    """What a scene (the rig's own) makes of exact places that the rig sees."""
    scene = rig if used is None else used
    seen = trace(rig, dent(name, rig, **numbers))
    return reconstruct(exact_correspondence(seen, 1e-3), scene, anchor=anchor)


def test_every_source_is_what_its_error_does(rig: Scene) -> None:
    height, rest = measured(rig, "gaussian", peak=0.2, sigma=5.0), measured(rig, "flat")
    found = budget(height, rest)
    point, depth, change = found.values()
    at = np.unravel_index(np.argmax(np.where(height.good, height.z, -1)), height.z.shape)
    around = height.good & (height.z <= 0.1 * height.z[at])
    for source, (name, sigma) in zip(("camera", "pattern"), SIGMAS.items(), strict=True):
        wrong = adjusted(replace(rig, covariance=None), {name: 0.2 * sigma})
        moved, moved_rest = (
            (measured(rig, kind, None, wrong, **numbers).z - right.z) / 0.2
            for right, kind, numbers in (
                (height, "gaussian", {"peak": 0.2, "sigma": 5.0}),
                (rest, "flat", {}),
            )
        )
        assert point[source] == pytest.approx(abs(moved[at]), rel=0.02)
        assert depth[source] == pytest.approx(abs(moved[at] - np.nanmean(moved[around])), rel=0.02)
        assert change[source] == pytest.approx(abs((moved - moved_rest)[at]), rel=0.05)
    for each in found.values():
        squares = [value**2 for name, value in each.items() if name != TOTAL]
        assert each[TOTAL] == pytest.approx(np.sqrt(sum(squares)))
    assert point[NOISE] == pytest.approx(height.sigma[at])
    assert point[TOTAL] == pytest.approx(height.total_sigma[at], rel=1e-5)


def test_sources_are_kept(rig: Scene, tmp_path: Path) -> None:
    height = measured(rig, "flat")
    height.save(tmp_path / "h.npz")
    back = HeightMap.load(tmp_path / "h.npz")
    assert back.sources == ("camera", "pattern")
    kept, own = budget(back), budget(height)
    assert kept == {name: pytest.approx(parts, rel=1e-6) for name, parts in own.items()}  # maps are float32
    rig.save(tmp_path / "rig.toml")
    assert load(tmp_path / "rig.toml") == rig
    assert budget(replace(height, flags=np.ones_like(height.flags))) == {}


@pytest.mark.parametrize("off", [0.05, -0.05])
def test_a_focal_length_by_tape_is_in_total_sigma_as_focal(off: float) -> None:
    """A focal length that is 5 % off, all other typed numbers exact; without the key, scale holds it. The
    anchors' planes were tilted by the way to them: total sigma was 20.7 um of 8.7 where it is too short."""
    zeros = dict.fromkeys((each.name for each in fields(Accuracy)), 0.0)
    typed = replace(resize(load("monitor-mirror"), 60, 80), accuracy=Accuracy(**zeros | {"focal": 0.05}))
    true = adjusted(typed, {"camera.f": (1 + off) * parameter_values(typed)["camera.f"]})
    pressed, rest = (
        exact_correspondence(trace(true, dent(name, true, **numbers)), 1e-3)
        for name, numbers in (("gaussian", {"peak": 0.2, "sigma": 15.0}), ("flat", {}))
    )
    height = reconstruct(pressed, typed, rest=rest)
    truth = trace(true, dent("gaussian", true, peak=0.2, sigma=15.0)).z
    deep = height.good & (truth > 0.15)
    error, sigma = np.abs(height.z - truth)[deep], height.total_sigma[deep]
    assert np.median(error) > 0.005  # mm
    assert np.median(error / sigma) == pytest.approx(1, rel=0.2)
    assert height.sources[0] == "focal length"
    narrow = replace(typed, accuracy=Accuracy(**zeros | {"focal": None, "scale": 0.01}))
    by_tape, by_scale = (
        next(iter(budget(reconstruct(pressed, each)).values()))["focal length"] for each in (typed, narrow)
    )
    assert by_tape == pytest.approx(5 * by_scale, rel=0.05)


def test_a_cover_glass_is_what_refraction_in_it_does(rig: Scene) -> None:
    """Places behind a plate of glass, each ray refracted as a vector, solved without it."""
    zeros = dict.fromkeys((each.name for each in fields(Accuracy)), 0.0)
    bare = replace(rig, covariance=None)
    seen = trace(bare, dent("gaussian", bare, peak=0.2, sigma=5.0))
    places = exact_correspondence(seen, 1e-3)
    height = reconstruct(places, replace(bare, accuracy=Accuracy(**zeros | {"glass": 0.1})))
    du, dv = behind_glass(bare, seen, 0.1)
    moved = reconstruct(replace(places, u=places.u + du, v=places.v + dv), bare)
    at = np.unravel_index(np.argmax(np.where(height.good, height.z, -1)), height.z.shape)
    point = next(iter(budget(height).values()))
    assert point["cover glass"] == pytest.approx(abs(moved.z[at] - height.z[at]), rel=0.02)


@pytest.mark.parametrize("at_rest", [False, True])
def test_an_error_that_all_u_share_is_in_sigma_and_cancels_against_rest(at_rest: bool) -> None:
    """Stripes of a display in colour that are unknown: a third of a cell in every pixel."""
    scene = resize(load("prism48", exact=True), 48, 64)
    shapes = [trace(scene, dent_from_text(text, scene)) for text in (scene.dent or "flat", "flat")]
    off = [replace(one, u=one.u + 1 / 3, common_u=1 / 3) for one in (exact_correspondence(t) for t in shapes)]
    found = reconstruct(off[0], scene, rest=off[1] if at_rest else None)
    error, known = (found.z - shapes[0].z)[found.good], found.calibration_sigma
    assert known is not None
    ratio = np.abs(error) / np.maximum(known[found.good], 1e-9)
    if at_rest:
        assert np.abs(error).max() < 5e-4
    else:
        assert 0.9 < np.median(ratio) < 1.1
        assert "colour stripes of the display" in found.sources
