"""Scenes with edges, displays unlike their sequence: light against closed forms, judges that judge."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lab.hard import hard_edges as edges
from lab.hard.hard_case import Case, Result, pooled, run_case
from lab.hard.layered import (
    Layer,
    Outline,
    World,
    inside,
    light,
    sampled,
)
from lab.hard.plain import plain_places
from optolever.decode import Correspondence, Finding, Flag, Integrity
from optolever.experiments.ideal import Fault
from optolever.patterns import sequence_from_text

F64 = NDArray[np.float64]
SIZE = (48, 64)
WALL = Layer(None, 1.0)
FLAT = World(SIZE, (64, 96), (WALL,), 0.9, (60.0, 31.0), 12.0, 0.4, black=0.0)


def pixels(world: World) -> tuple[F64, F64]:
    """x and y of pixel centres from the image's centre."""
    rows, cols = world.size
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    return x - (cols - 1) / 2, y - (rows - 1) / 2


def truth(world: World) -> tuple[F64, F64]:
    centre = sampled(world, 1)
    return inside(centre.u).astype(np.float64), inside(centre.v).astype(np.float64)


# ---------------------------------------------------------------- geometry


def test_planes_and_shadows_are_those_of_rays_in_space() -> None:
    """Camera at 0, projector at (b, 0, 0), focal lengths f and r f: rays meet planes n . P = 1 in 3-D."""
    f, r, b = 80.0, 0.7, 0.25
    normals = np.array([[0.1, -0.15, 1.0], [-0.2, 0.3, 1.55]])
    disc = Outline(6.0, -3.0, ((1.0, 0.0, 14.0), (0.0, 1.0, 9.0)), elliptic=True)
    layers = (
        Layer(None, normals[0, 2], (normals[0, 0] / f, normals[0, 1] / f)),
        Layer(
            disc,
            float(normals[1] @ [disc.x / f, disc.y / f, 1]),
            (normals[1, 0] / f, normals[1, 1] / f),
        ),
    )
    world = World(SIZE, (400, 400), layers, r, (200.0, 190.0), r * f * b)
    x, y = pixels(world)
    rays = np.stack([x / f, y / f, np.ones_like(x)], axis=-1)
    on_disc = ((x - disc.x) / 14) ** 2 + ((y - disc.y) / 9) ** 2 < 1
    points = rays / np.where(on_disc, rays @ normals[1], rays @ normals[0])[..., None]
    projector = np.array([b, 0.0, 0.0])
    away = points - projector
    seen = sampled(world, 1)
    np.testing.assert_allclose(inside(seen.u), 200 + r * f * away[..., 0] / away[..., 2], atol=1e-3)
    np.testing.assert_allclose(inside(seen.v), 190 + r * f * away[..., 1] / away[..., 2], atol=1e-3)
    # the way from the projector to a point of the wall meets the disc's plane at a share s of its length
    s = (1 - normals[1] @ projector) / (away @ normals[1])
    met = projector + s[..., None] * away
    column, row = f * met[..., 0] / met[..., 2], f * met[..., 1] / met[..., 2]
    within = ((column - disc.x) / 14) ** 2 + ((row - disc.y) / 9) ** 2 < 1
    shadow = ~on_disc & within & (s > 0) & (s < 1)
    assert 50 < shadow.sum() < on_disc.sum()
    assert np.array_equal(inside(seen.lit), ~shadow)


def test_fringes_on_a_plane_are_cosines_of_the_known_contrast() -> None:
    """Of a cell, a pixel's area and the point spread: sinc(1/P) sinc(r/P) exp(-2 (pi s r/P)^2)."""
    period, sequence = 16.0, sequence_from_text("phase:steps=3,periods=16,axes=u", 64, 96)
    shot = light(FLAT, sampled(FLAT), sequence)
    x, _ = pixels(FLAT)
    u = 60 + 0.9 * x - 12 * math.cos(0.4)
    contrast = np.sinc(1 / period) * np.sinc(0.9 / period)
    contrast *= math.exp(-2 * (math.pi * FLAT.spread * 0.9 / period) ** 2)
    for frame, levels in zip(sequence.frames, shot, strict=True):
        expected = 100 * (1 + contrast * np.cos(2 * np.pi * u / period - (frame.shift or 0)))
        np.testing.assert_allclose(levels, expected, atol=0.4)


def test_a_pixel_at_a_depth_edge_mixes_two_places() -> None:
    """Edge between the two middle columns, dark on one side and bright on the other: they add up to one."""
    half = Outline(-40.0, 0.0, ((1.0, 0.0, 40.0), (0.0, 1.0, 99.0)))
    world = replace(FLAT, layers=(WALL, Layer(half, 2.0)), baseline=math.pi, origin=(30.0, 31.0))
    bright = sequence_from_text("binary:axes=u,cell=48", 64, 96)
    shot = light(world, sampled(world), bright)
    left, right = shot[2][:, 31], shot[2][:, 32]  # the only bit: dark below u = 47.5
    assert (left > 20).all()
    np.testing.assert_allclose(left + right, 200, atol=0.5)
    assert inside(sampled(world).trouble, 4)[:, 127:129].all()


# ---------------------------------------------------------------- draws


@pytest.mark.parametrize("code", edges.EDGE_CODES)
def test_a_code_by_its_definition_gives_the_place(code: str) -> None:
    sequence = sequence_from_text(code, *FLAT.pattern)
    places = plain_places(light(FLAT, sampled(FLAT, 1), sequence), sequence)
    loose = 1.01 if "binary" in code else 0.51
    for place, true in zip(places, truth(FLAT), strict=True):
        assert np.abs(place - true).max() < loose


# ---------------------------------------------------------------- judges


def oracle(shot: edges.Taken, off: float = 0.0, flags: int = 0) -> Correspondence:
    """A decoder that knows the truth, or is off by so many pixels."""
    sigma = np.full(shot.u.shape, 0.1)
    return Correspondence(shot.u + off, shot.v, sigma, sigma, np.full(shot.u.shape, flags, np.uint16))


def verdict(
    monkeypatch: pytest.MonkeyPatch, draw: edges.Draw, *accused: tuple[int, ...], **wrong: Any
) -> Result:
    findings = tuple(Finding(frames, "made up", "made up") for frames in accused)
    shot = edges.taken(draw)
    monkeypatch.setattr(edges, "decode", lambda *_: oracle(shot, **wrong))
    monkeypatch.setattr(edges, "check", lambda *_: Integrity(findings, 1))
    return run_case(
        Case(
            "edges", "fault 0" if draw.fault else "clean 0", draw.code, SIZE, lambda: edges.judged_draw(draw)
        )
    )


def test_clean_draws_are_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    draw = edges.drawn(1, False, SIZE)
    assert verdict(monkeypatch, draw).verdict == "good"
    silent = verdict(monkeypatch, draw, off=0.6)
    assert (silent.verdict, silent.silent, silent.fault) == ("silent errors", 1.0, True)
    accused = verdict(monkeypatch, draw, flags=int(Flag.WRONG_FRAME))
    assert (accused.verdict, accused.fault, accused.flagged) == ("right frame accused", True, 1.0)
    figures = {figure.name: figure for figure in pooled([silent, accused])}
    assert figures["right frames accused, of draws"].value == 0.5
    assert not figures["good pixels away from edges"].met
    assert figures["silent errors there, of unflagged pixels"].value == 1.0


def test_faulty_draws_are_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    draw = edges.drawn(4, False, SIZE)
    # the finest period in the coarse one's place, both of them 4 steps of u
    bad = replace(draw, code="phase", variant="raw", fault=Fault("swapped", 9, 1))
    right = verdict(monkeypatch, bad, (1,))
    assert (right.verdict, right.fault) == ("named", False)
    blind = verdict(monkeypatch, bad)
    assert (blind.verdict, blind.fault) == ("not named", False)
    assert verdict(monkeypatch, bad, (2, 3)).verdict == "not named"
    assert verdict(monkeypatch, bad, tuple(range(12))).verdict == "not named"  # that is naming nobody
    assert verdict(monkeypatch, bad, *((frame,) for frame in range(12))).verdict == "not named"
    alike = replace(bad, fault=Fault("twice", 3, 3))
    assert verdict(monkeypatch, alike).verdict == "harmless fault"
    figures = {figure.name: figure for figure in pooled([right, blind])}
    named = figures["wrong frames named, of faults that count"]
    assert (named.value, named.count, named.met) == (0.5, 2, False)
