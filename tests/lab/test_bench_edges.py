"""Scenes with edges, displays unlike their sequence: light against closed forms, judges that judge."""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lab.hard import hard_edges as edges
from lab.hard import hard_unlike as unlike
from lab.hard.hard import hard_cases
from lab.hard.hard_case import Case, Result, judged, pooled, run_case
from lab.hard.layered import (
    Deviation,
    Layer,
    Outline,
    World,
    inside,
    light,
    sampled,
)
from lab.hard.plain import plain_places
from lab.program import run
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


def test_a_bent_surface_shadows_where_a_fine_search_says() -> None:
    """Its own inverse depth on the projector's ray solves q = q(x(q)): found by bisection."""
    outline = Outline(5.0, 0.0, ((1.0, 0.0, 12.0), (0.0, 1.0, 30.0)))
    layer = Layer(outline, 1.6, (0.002, 0.001), 0.002)
    world = replace(FLAT, layers=(WALL, layer), disparity=18.0, pattern=(200, 300), origin=(150.0, 100.0))
    x, y = pixels(world)
    su, sv = world.shift
    u, v = truth(world)
    low, high = np.full(x.shape, 1.0), np.full(x.shape, 3.0)
    for _ in range(40):
        q = (low + high) / 2
        across, down = (u - 150 + su * q) / 0.9, (v - 100 + sv * q) / 0.9
        further = q < 1.6 + 0.002 * (across - 5) + 0.001 * down + 0.001 * ((across - 5) ** 2 + down**2)
        low, high = np.where(further, q, low), np.where(further, high, q)
    within = (np.abs(across - 5) < 12) & (np.abs(down) < 30)
    own = (np.abs(x - 5) < 12) & (np.abs(y) < 30)
    differ = inside(sampled(world, 1).lit) != ~(within & ~own)
    assert (within & ~own).sum() > 100
    assert differ.mean() < 0.005  # rounding at the shadow's border


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


def test_deviations_are_what_they_are_called() -> None:
    centre, sequence = sampled(FLAT, 1), sequence_from_text("phase:steps=4,periods=16,axes=u", 64, 96)
    plain = light(FLAT, centre, sequence) / 200
    np.testing.assert_allclose(
        light(FLAT, centre, sequence, Deviation(gamma=2.2)) / 200, plain**2.2, atol=1e-4
    )
    lag = light(FLAT, centre, sequence, Deviation(lag=0.1)) / 200
    np.testing.assert_allclose(lag[2], 0.9 * plain[2] + 0.1 * plain[1], atol=1e-4)
    ghost = light(FLAT, centre, sequence, Deviation(ghost=0.05, apart=(16.0, 0.0))) / 200
    inner = truth(FLAT)[0] < 78
    np.testing.assert_allclose(ghost[:, inner], 1.05 * plain[:, inner], atol=1e-3)
    flicker = light(FLAT, centre, sequence, Deviation(flicker=0.02), np.random.default_rng(0)) / 200
    ratio = (flicker / np.maximum(plain, 1e-6))[:, plain.min(axis=0) > 0.05]
    assert np.ptp(ratio, axis=1).max() < 1e-4
    assert 0.005 < np.abs(ratio - 1).max() <= 0.02


# ---------------------------------------------------------------- draws


@pytest.mark.parametrize("code", edges.EDGE_CODES)
def test_a_code_by_its_definition_gives_the_place(code: str) -> None:
    sequence = sequence_from_text(code, *FLAT.pattern)
    places = plain_places(light(FLAT, sampled(FLAT, 1), sequence), sequence)
    loose = 1.01 if "binary" in code else 0.51
    for place, true in zip(places, truth(FLAT), strict=True):
        assert np.abs(place - true).max() < loose


def test_faults_are_what_they_are_called() -> None:
    frames = np.broadcast_to(np.arange(6)[:, None, None], (6, 8, 2)).copy()

    def order(kind: str, row: int) -> list[int]:
        return [int(n) for n in Fault(kind, 4, 1, 0.5).spoil(frames)[:, row, 0]]

    assert order("swapped", 0) == [0, 4, 2, 3, 1, 5]
    assert order("twice", 0) == [0, 1, 2, 3, 1, 5]
    assert order("torn", 3) == [0, 1, 2, 3, 4, 5]
    assert order("torn", 4) == [0, 1, 2, 3, 1, 5]
    assert order("lost", 0) == [0, 1, 2, 3, 5, 5]


@pytest.mark.parametrize(
    ("code", "other", "middle", "moved", "perfect"),
    [
        ("gray:inverses=false", 3, 105.0, 1.0, True),
        ("gray:inverses=false", 3, 75.0, 0.5, False),  # an edge of bit 6 is in view: the map is torn
        ("gray:inverses=false", 0, 105.0, 1.0, False),  # white
        ("gray", 4, 105.0, 1.0, False),  # the inverses stay where they are
        ("gray", 5, 105.0, 0.0, True),  # as dark as bit 7
    ],
)
def test_perfect_frames_of_another_scene_are_nobodys_fault(
    code: str, other: int, middle: float, moved: float, perfect: bool
) -> None:
    """Of eight bits of u, 66 to 122 in view, 7 (frame 2) is dark and 6 bright: in each other's place they
    make the same scene elsewhere."""
    world = replace(FLAT, black=5.0, pattern=(64, 256), origin=(middle, 31.0))
    draw = replace(edges.drawn(0, False, SIZE), world=world, variant="raw", code=code)
    shot = edges.taken(replace(draw, fault=Fault("swapped", 2, other)))
    assert shot.moved == pytest.approx(moved, abs=0.02)
    assert shot.perfect == perfect


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


@pytest.mark.parametrize(
    ("sigma", "notices", "expected"),
    [(0.05, 1, "good"), (0.005, 1, "silent errors"), (1.0, 1, "sigma too wide"), (0.05, 0, "no notice")],
)
def test_displays_unlike_their_sequence_are_judged(
    sigma: float, notices: int, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = unlike.smooth_world(SIZE)
    u, v = truth(world)
    noise = 0.05 * np.random.default_rng(0).standard_normal((2, *u.shape))
    seen = SimpleNamespace(
        u=u + noise[0],
        v=v + noise[1],
        sigma_u=np.full(u.shape, sigma),
        sigma_v=np.full(u.shape, sigma),
        flags=np.zeros(u.shape, np.uint16),
        notices=("",) * notices,
    )
    monkeypatch.setattr(unlike, "decode", lambda *_: seen)
    (case,) = (one for one in unlike.unlike_cases(SIZE) if one.label.startswith("unlike gamma 2.2 micro"))
    result = judged(case, case.make())
    assert result.verdict == expected
    assert result.width == pytest.approx(sigma / 0.05, rel=0.1)


def test_the_command_draws_as_many_as_asked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    shots: list[edges.Taken] = []
    take = edges.taken
    monkeypatch.setattr(edges, "taken", lambda draw: shots.append(take(draw)) or shots[-1])
    monkeypatch.setattr(edges, "decode", lambda *_: oracle(shots[-1]))
    monkeypatch.setattr(edges, "check", lambda *_: Integrity((), 1))
    told = tmp_path / "told.json"
    asked = ["hard", "--filter", "edges", "--draws", "2", "--first", "3", "--size", "48x64"]
    run([*asked, "--out", str(tmp_path), "--json", str(told)])
    record = json.loads(told.read_text())
    assert [case["case"].split(":")[0].split(",")[0] for case in record["cases"]] == [
        *("clean 3", "clean 4", "fault 3", "fault 4")
    ]
    assert record["faults"] == 0
    assert {figure["name"] for figure in record["pooled"]} >= {"right frames accused, of draws"}
    assert len(hard_cases(wanted="edges")) == 48
