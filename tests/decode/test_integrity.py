"""Swapped, lost, repeated, replaced and torn frames are named; whole captures are not, edges or none."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Finding, Flag, check, decode
from optolever.patterns import Sequence, sequence

from .conftest import F64, Map, Shoot, silent
from .light import cell_frames

CASES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("phase", {"steps": 4}),
    ("phase", {"steps": 8, "periods": (190.0, 16.0)}),
    ("phase", {"steps": 3, "periods": (8.74, 8.06, 8.0)}),
    ("micro-phase", {}),
    ("gray", {}),
    ("gray", {"references": False}),
    ("gray", {"inverses": False}),
    ("binary", {"cell": 2.0}),
    ("gray+phase", {}),
    ("gray+phase", {"inverses": True}),
)
EDGES = ("gray", "gray:inverses", "gray:references", "binary", "phase", "gray+phase")


def _shown(name: str, rows: int = 150, cols: int = 170) -> Sequence:
    """gray:inverses is a Gray code without them."""
    kind, _, without = name.partition(":")
    params: dict[str, Any] = {without: False} if without else {}
    return sequence(kind, rows, cols, **params, **({"cell": 2.0} if kind == "binary" else {}))


def _named(frames: NDArray[Any], shown: Sequence) -> Finding:
    (finding,) = check(frames, shown).findings
    return finding


@pytest.mark.daily(5)
@pytest.mark.parametrize(("name", "params"), CASES)
def test_neighbours_in_each_others_place_are_named_and_nothing_in_whole_captures(
    name: str, params: dict[str, Any], shoot: Shoot, smooth: Map
) -> None:
    shown = sequence(name, 150, 170, **params)
    for noise in (0.0, 8.0):
        assert check(shoot(shown, *smooth, noise=noise), shown).findings == ()
    frames = shoot(shown, *smooth, noise=1.0)
    first = len(shown) // 2 + len(shown) % 2 - 1
    frames[[first, first + 1]] = frames[[first + 1, first]]
    found = check(frames, shown).findings
    pair = shown.frames[first].bit is not None and shown.frames[first].bit == shown.frames[first + 1].bit
    if not pair and shown.frames[first].bit != 1:  # else a bit and its inverse, or finest ones: 2 cells
        assert {first, first + 1} <= set(found[0].frames)


@pytest.mark.daily(1)
@pytest.mark.parametrize(("lit", "around"), [(0.3, "room"), (0.03, "dark")])
def test_surroundings_hide_no_fault(lit: float, around: str, shoot: Shoot) -> None:
    row, col = np.mgrid[:240, :320].astype(np.float64)
    inside = np.hypot((row - 120) / 120, (col - 160) / 160) < np.sqrt(lit)
    shown = sequence("gray+phase", 150, 170)
    light = 100.0 if around == "room" else 4.0
    u, v = 85 + 0.5 * (col - 160), 75 + 0.5 * (row - 120)
    whole = shoot(shown, u, v, noise=1.0, amplitude=inside * 80.0, offset=np.where(inside, 90.0, light))
    assert check(whole, shown).findings == ()
    for i in (6, 10, 16, 18):
        frames = whole.copy()
        frames[[i, i + 1]] = whole[[i + 1, i]]
        assert {i, i + 1} & set(_named(frames, shown).frames), i


def test_a_lost_and_a_repeated_frame_are_named(shoot: Shoot, smooth: Map) -> None:
    shown = sequence("phase", 150, 170, steps=8, periods=(190.0, 16.0))
    whole = shoot(shown, *smooth, noise=1.0)
    lost, repeated = whole.copy(), whole.copy()
    lost[11:-1] = whole[12:]
    repeated[12:] = whole[11:-1]
    for kind, frames in (("lost", lost), ("repeated", repeated)):
        finding = _named(frames, shown)
        assert finding.kind == kind
        assert {11, 12} & set(finding.frames)


@pytest.mark.daily(3)
@pytest.mark.parametrize("name", EDGES)
def test_a_torn_frame_is_named_with_its_rows(name: str, shoot: Shoot, smooth: Map) -> None:
    shown = _shown(name)
    frames = shoot(shown, *smooth, noise=1.0)
    torn = 7
    frames[torn, 50:] = frames[torn - 1, 50:]
    finding = _named(frames, shown)
    assert torn in finding.frames
    if finding.rows is not None:
        assert abs(finding.rows[0] - 50) < 25


@pytest.mark.daily(1)
@pytest.mark.parametrize(
    ("kind", "inverses", "blur", "width", "good"),
    [
        ("binary", True, 1.0, 0.6, 0.97),
        ("binary", True, 1.0, 1.1, 0.97),
        ("binary", True, 0.8, 2.0, 0.97),
        ("binary", False, 1.2, 1.1, 0.97),
        ("xor-gray", True, 1.2, 1.1, 0.5),
    ],
)
def test_bits_that_a_blur_hides_are_no_fault(
    kind: str, inverses: bool, blur: float, width: float, good: float
) -> None:
    """Of fine bits nothing is left, so that they look like each other."""
    shown = sequence(kind, 220, 290, inverses=inverses)
    row, col = np.mgrid[:96, :128].astype(np.float64)
    u, v = 15 + 0.9 * width * col + 0.5 * np.sin(row / 17), 15 + width * row + 0.5 * np.cos(col / 19)
    frames = cell_frames(shown, u, v, blur=blur, noise=1.0)
    assert check(frames, shown).findings == ()
    assert decode(frames, shown).good.mean() > good


@pytest.mark.daily(1)
@pytest.mark.parametrize(
    "map_of",
    [
        lambda row, col: 350 + 0.6 * col + 37 * (col > 120),
        lambda row, col: 350 + 0.6 * col + 271 * (col > 309),
        lambda row, col: 350 + 0.6 * col + 63 * (col + 0.1 * row > 143),
        lambda row, col: 350 + 0.6 * col + 260 * (col + 0.1 * row > 328),
        lambda row, col: 80 + 0.3 * col + 830 * (np.hypot(row - 60, col - 80) < 40),
    ],
)
def test_the_edge_of_an_object_is_no_wrong_frame(shoot: Shoot, map_of: Callable[[F64, F64], F64]) -> None:
    """One of a few coarse bits explains many a jump; two bits that change within it only show the same."""
    row, col = np.mgrid[:200, :480].astype(np.float64)
    for name in ("gray+phase", "gray:inverses"):
        shown = _shown(name, 256, 1024)
        assert check(shoot(shown, map_of(row, col), 20 + 1.1 * row, noise=0.5), shown).findings == ()


def _scene(rng: np.random.Generator, rows: int = 160, cols: int = 200) -> tuple[F64, F64, F64]:
    """u, v and brightness (each 4 rows x 4 cols) of a wall, discs before it, their shadows, and a hole."""
    row, col = np.mgrid[: 4 * rows, : 4 * cols].astype(np.float64) / 4
    u, v = 60 + 0.45 * col + 0.0004 * (row - 80) ** 2, 20 + 0.5 * row + 4 * np.sin(col / 60)
    bright = 60 + 25 * np.sin(row / 40) * np.cos(col / 50)
    for _ in range(rng.integers(2, 6)):
        y, x, radius = rng.uniform(0, rows), rng.uniform(0, cols), rng.uniform(15, 35)
        disc = np.hypot(row - y, col - x) < radius
        bright = np.where(np.hypot(row - y, col - x + 8) < radius, 0.0, bright)
        u = np.where(disc, 60 + 0.45 * col + rng.uniform(15, 90) + rng.uniform(-0.1, 0.1) * (col - x), u)
        bright = np.where(disc, rng.uniform(40, 90), bright)
    bright = np.where(np.hypot(row - rng.uniform(0, rows), col - rng.uniform(0, cols)) < 8, 0.0, bright)
    return u, v, bright


def _photo(shown: Sequence, scene: tuple[F64, F64, F64], rng: np.random.Generator, jpeg: int) -> NDArray[Any]:
    """Area means of 4 x 4 samples of what the cells show; jpeg: quality, 0: none."""
    u, v, bright = scene
    at = (
        np.clip(np.rint(v), 0, shown.rows - 1).astype(int),
        np.clip(np.rint(u), 0, shown.cols - 1).astype(int),
    )
    frames = []
    for image in shown.render():
        light = cv2.resize(
            bright * 2 * image[at] / 255.0, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA
        )
        level = np.clip(np.rint(12 + light + rng.standard_normal(light.shape)), 0, 255).astype(np.uint8)
        if jpeg:
            level = cv2.imdecode(cv2.imencode(".jpg", level, [cv2.IMWRITE_JPEG_QUALITY, jpeg])[1], 0)
        frames.append(level)
    return np.stack(frames)


def _moves_places(frames: NDArray[Any], whole: NDArray[Any], shown: Sequence) -> bool:
    """Whether more than 1 % of the pixels are elsewhere."""
    found, true = (decode(one, shown, check=False) for one in (frames, whole))
    off = np.abs([found.u - true.u, found.v - true.v]).max(axis=0)
    both = found.good & true.good
    return not both.any() or bool(np.mean(off[both] > 1) > 0.01)


@pytest.mark.daily(2)
@pytest.mark.parametrize("name", EDGES)
def test_scenes_with_edges_are_no_fault_and_hide_none(name: str) -> None:
    shown = _shown(name, 128, 256)
    for seed in (EDGES.index(name),):
        rng = np.random.default_rng(seed)
        whole = _photo(shown, _scene(rng), rng, jpeg=80 * (seed % 2))
        assert check(whole, shown).findings == (), seed
        for kind in ("swapped", "twice", "torn"):
            i = int(rng.integers(3, len(shown) - 4))
            frames = whole.copy()
            if kind == "swapped":
                frames[[i, i + 3]] = whole[[i + 3, i]]
            else:
                start = 60 if kind == "torn" else 0
                frames[i, start:] = whole[i + 1, start:]
            bit, named = (
                shown.frames[i].bit,
                i in {j for one in check(frames, shown).findings for j in one.frames},
            )
            if bit is None:  # a fringe of which hardly anything changes
                assert named or not _moves_places(frames, whole, shown), (seed, kind, i)
            elif bit >= 2 or shown.frames[i].inverted:
                assert named, (seed, kind, i)


@pytest.mark.parametrize("step", [8.0])
def test_sweeps_are_tested_by_how_stripes_follow_each_other(step: float, shoot: Shoot, smooth: Map) -> None:
    shown = sequence("stripe", 150, 170, step=step, axes="u")
    whole = shoot(shown, *smooth, noise=1.0)
    assert check(whole, shown).findings == ()
    i = len(shown) // 2
    faults = {name: whole.copy() for name in ("replaced", "swapped", "lost", "repeated")}
    faults["replaced"][i] = whole[i - 1]
    faults["swapped"][[i, i + 1]] = whole[[i + 1, i]]
    faults["lost"][i:-1] = whole[i + 1 :]
    faults["repeated"][i + 1 :] = whole[i:-1]
    for kind, frames in faults.items():
        finding = _named(frames, shown)
        assert finding.kind == kind
        assert {i, i + 1} & set(finding.frames)


def test_only_pixels_that_a_wrong_step_could_spoil_are_blamed(shoot: Shoot, smooth: Map) -> None:
    """A step replaced by its neighbour is right where both are the same; of eight, one may be left out."""
    shown = sequence("phase", 150, 170, steps=8, periods=(190.0, 16.0))
    frames = shoot(shown, *smooth, noise=1.0)
    frames[10] = frames[11]
    finding = _named(frames, shown)
    assert finding.frames == finding.leave_out == (10,)
    assert finding.confidence > 0.99
    assert 0 < finding.share <= 1
    shown = sequence("phase", 150, 170, steps=4, periods=(190.0, 16.0))
    frames = shoot(shown, *smooth, noise=1.0)
    before = frames[1].astype(float)
    frames[1] = frames[2]
    found = decode(frames, shown, on_cells=False)
    blamed, apart = found.flags & Flag.WRONG_FRAME > 0, np.abs(frames[1] - before)
    assert not blamed[apart < 8].any()
    assert blamed[apart > 45].mean() > 0.99
    assert silent(found, *smooth) == 0


@pytest.mark.daily(1)
@pytest.mark.parametrize("swap", [(0, 1), (0, 2), (1, 3)])
def test_two_swapped_steps_that_nothing_decodes_without_are_put_back(
    swap: tuple[int, int], shoot: Shoot, smooth: Map
) -> None:
    """Of four steps, either pair of opposite ones mirrors the phase; the finer periods tell which it is."""
    shown = sequence("phase", 150, 170, steps=4)
    frames = shoot(shown, *smooth, noise=1.0)
    frames[list(swap)] = frames[list(swap[::-1])]
    found = decode(frames, shown, on_cells=False)
    assert silent(found, *smooth) == 0
    assert found.good.mean() > 0.99
    assert f"frames {swap[0]} and {swap[1]} are in each other's place" in found.notices[0].name


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_white_and_black_in_each_others_place(noise: float, shoot: Shoot, smooth: Map) -> None:
    shown = sequence("gray", 150, 170)
    frames = shoot(shown, *smooth, noise=noise)
    frames[[0, 1]] = frames[[1, 0]]
    found = decode(frames, shown)
    assert [notice.name for notice in found.notices] == ["frames 0 and 1 are in each other's place"]
    assert silent(found, *smooth, least=1.5) == 0
