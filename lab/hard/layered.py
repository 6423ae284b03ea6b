"""A projector and a camera before surfaces at several depths: the light of every frame, and the truth.

With (x, y) the camera pixel from the image's centre, q the inverse depth in units of the wall's, r projector
pixels per camera pixel, D the wall's disparity (projector pixels) and t the direction of the baseline,

    u = u0 + r x - D cos(t) q,    v = v0 + r y - D sin(t) q.

A plane is an affine q(x, y). Light is summed over samples within each pixel, spread by the camera's optics,
and only then read: a pixel at an edge mixes two places. Nothing of the decoder's model is used.
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from optolever.experiments.arrays import Mask
from optolever.patterns import Sequence

Floats = NDArray[np.float32]
T = TypeVar("T", bound=np.generic)

SAMPLES = 4  # per pixel and direction
FINE = 128  # places of a sample within a pattern pixel
MARGIN = 5  # px around the image, from which light spreads into it
GLOSSY = 2.0  # levels of gloss, above which a sample counts as glossy
NEARER = 1e-4  # inverse depth by which a surface must be nearer to cast a shadow


@dataclass(frozen=True, slots=True)
class Outline:
    """A convex shape about (x, y), camera pixels from the image's centre.

    sides (K, 3): direction (2) of a pair of parallel sides' normal and their distance from the middle;
    elliptic: the two distances are the semi-axes of an ellipse instead.
    """

    x: float
    y: float
    sides: tuple[tuple[float, float, float], ...]
    elliptic: bool = False

    def holds(self, x: Floats, y: Floats) -> Mask:
        """Whether points lie inside."""
        dx, dy = x - np.float32(self.x), y - np.float32(self.y)
        across = [(np.float32(a / h) * dx + np.float32(b / h) * dy) ** 2 for a, b, h in self.sides]
        return np.asarray((sum(across) if self.elliptic else np.maximum.reduce(across)) < 1)


@dataclass(frozen=True, slots=True)
class Layer:
    """A surface with inverse depth q = depth + tilt . (dx, dy) + bend / 2 (dx^2 + dy^2) about its outline's
    middle (None: everywhere, about the image's centre). albedo: range of its texture."""

    outline: Outline | None
    depth: float
    tilt: tuple[float, float] = (0.0, 0.0)
    bend: float = 0.0
    albedo: tuple[float, float] = (1.0, 1.0)

    @property
    def middle(self) -> tuple[float, float]:
        """Where q is `depth`, camera pixels."""
        return (0.0, 0.0) if self.outline is None else (self.outline.x, self.outline.y)

    def inverse_depth(self, x: Floats, y: Floats) -> Floats:
        """q at camera positions."""
        dx, dy = x - np.float32(self.middle[0]), y - np.float32(self.middle[1])
        plane = np.float32(self.depth) + np.float32(self.tilt[0]) * dx + np.float32(self.tilt[1]) * dy
        return np.asarray(plane + np.float32(self.bend / 2) * (dx * dx + dy * dy) if self.bend else plane)


@dataclass(frozen=True, slots=True)
class Gloss:
    """A streak through (x, y): `peak` levels, Gaussian of rms `width` pixels across. lamp: light of a lamp,
    which is there in every frame; else of the projector."""

    x: float
    y: float
    angle: float
    width: float
    peak: float
    lamp: bool

    def levels(self, x: Floats, y: Floats) -> Floats:
        """What it adds at camera positions."""
        across = (x - self.x) * math.sin(self.angle) - (y - self.y) * math.cos(self.angle)
        return np.asarray(self.peak * np.exp(-0.5 * (across / self.width) ** 2), np.float32)


@dataclass(frozen=True, slots=True)
class World:
    """size, pattern: camera, projector (rows, cols); layers[0]: the wall; scale r, origin (u0, v0),
    disparity D, baseline t (radians): as above; holes: openings to the dark; prints: dark ink with sharp
    edges; gain: levels that projector light makes on albedo 1; ambient: other light, likewise; black: of the
    camera; spread: rms of the optics' point spread, camera pixels; seed: of the textures."""

    size: tuple[int, int]
    pattern: tuple[int, int]
    layers: tuple[Layer, ...]
    scale: float
    origin: tuple[float, float]
    disparity: float = 0.0
    baseline: float = 0.0
    holes: tuple[Outline, ...] = ()
    prints: tuple[Outline, ...] = ()
    gloss: tuple[Gloss, ...] = ()
    gain: float = 200.0
    ambient: float = 0.0
    black: float = 8.0
    spread: float = 0.8
    seed: int = 0

    @property
    def shift(self) -> tuple[float, float]:
        """Projector pixels along u and v per unit of inverse depth."""
        return self.disparity * math.cos(self.baseline), self.disparity * math.sin(self.baseline)


@dataclass(frozen=True, slots=True)
class Samples:
    """What points of the image and of a margin around it look at, (n H, n W) with the margin each.

    u, v: projector coordinates; layer: number; lit: whether projector light falls there; projected, other:
    levels of projector light and of all other light; trouble: shadow, hole, gloss, or an edge of depth,
    shadow or ink beside.
    """

    u: Floats
    v: Floats
    layer: NDArray[np.uint8]
    lit: Mask
    projected: Floats
    other: Floats
    trouble: Mask


@dataclass(frozen=True, slots=True)
class Deviation:
    """What a projector does that its sequence does not tell.

    gamma: light = level^gamma; flicker: amplitude of a relative change of brightness from frame to frame;
    lag: share of the frame before; ghost: brightness of a second image, `apart` projector pixels (u, v) away.
    """

    gamma: float = 1.0
    flicker: float = 0.0
    lag: float = 0.0
    ghost: float = 0.0
    apart: tuple[float, float] = (37.3, 21.7)


PLAIN = Deviation()


def sampled(world: World, count: int = SAMPLES) -> Samples:
    """The world at count x count points in every camera pixel; 1: at the pixels' centres."""
    rows, cols = (n + 2 * MARGIN for n in world.size)
    y, x = (np.asarray((np.arange(n * count) + 0.5) / count - 0.5 * n, np.float32) for n in (rows, cols))
    x, y = np.meshgrid(x, y)
    layer, q = _nearest(world, x, y)
    (su, sv), r = world.shift, world.scale
    u = np.asarray(world.origin[0] + r * x - su * q, np.float32)
    v = np.asarray(world.origin[1] + r * y - sv * q, np.float32)
    lit = (u > -0.5) & (v > -0.5) & (u < world.pattern[1] - 0.5) & (v < world.pattern[0] - 0.5)
    for other in world.layers:
        lit &= ~_shadow(world, other, u, v, q)
    return _lighted(world, x, y, Samples(u, v, layer, lit, u, u, lit), count)


def _nearest(world: World, x: Floats, y: Floats) -> tuple[NDArray[np.uint8], Floats]:
    """Number and inverse depth of the nearest layer."""
    q = world.layers[0].inverse_depth(x, y)
    number = np.zeros(x.shape, np.uint8)
    for i, layer in enumerate(world.layers[1:], 1):
        assert layer.outline is not None
        own = layer.inverse_depth(x, y)
        nearer = layer.outline.holds(x, y) & (own > q)
        q, number = np.where(nearer, own, q), np.where(nearer, np.uint8(i), number)
    return number, q


def _shadow(world: World, layer: Layer, u: Floats, v: Floats, q: Floats) -> Mask:
    """Where a layer is between the projector and the points (u, v, q): its own q on the projector's ray is
    a root of a quadratic, that of the plane where it does not bend."""
    if layer.outline is None:
        return np.zeros(u.shape, np.bool_)
    r, (cx, cy), (px, py), bend = world.scale, layer.middle, layer.tilt, layer.bend
    bx, by = world.shift[0] / r, world.shift[1] / r
    ax = (u - np.float32(world.origin[0])) / np.float32(r) - np.float32(cx)
    ay = (v - np.float32(world.origin[1])) / np.float32(r) - np.float32(cy)
    a = bend / 2 * (bx * bx + by * by)
    b = np.float32(px * bx + py * by - 1) + np.float32(bend) * (ax * np.float32(bx) + ay * np.float32(by))
    c = np.float32(layer.depth) + np.float32(px) * ax + np.float32(py) * ay
    c += np.float32(bend / 2) * (ax * ax + ay * ay)
    # no root: far off its outline, which then says so
    own = 2 * c / np.maximum(np.sqrt(np.maximum(b * b - np.float32(4 * a) * c, 0)) - b, np.float32(1e-6))
    x, y = ax + np.float32(bx) * own + np.float32(cx), ay + np.float32(by) * own + np.float32(cy)
    return np.asarray(layer.outline.holds(x, y) & (own > q + NEARER))


def _lighted(world: World, x: Floats, y: Floats, seen: Samples, count: int) -> Samples:
    """With levels of light and what is in the way."""
    albedo = np.empty(x.shape, np.float32)
    for i, layer in enumerate(world.layers):
        np.copyto(albedo, _texture(world, layer.albedo, i, x.shape), where=seen.layer == i)
    hole, ink = (_any(outlines, x, y) for outlines in (world.holes, world.prints))
    albedo[ink] *= 0.45
    albedo[hole] = 0.0
    lamp, mirrored = (
        np.asarray(sum((g.levels(x, y) for g in world.gloss if g.lamp == lamp), np.zeros_like(x)))
        for lamp in (True, False)
    )
    trouble = hole | ~seen.lit | (lamp + mirrored > GLOSSY)
    region = seen.layer + np.uint8(64) * ink + np.uint8(128) * seen.lit
    near = np.ones((3, 3), np.uint8)
    trouble |= cv2.dilate(region, near) != cv2.erode(region, near)
    projected = np.where(seen.lit, np.float32(world.gain) * albedo + mirrored, np.float32(0))
    other = np.float32(world.ambient) * albedo + lamp + np.float32(world.black)
    return Samples(seen.u, seen.v, seen.layer, seen.lit, projected, other, trouble)


def _any(outlines: tuple[Outline, ...], x: Floats, y: Floats) -> Mask:
    found = np.zeros(x.shape, np.bool_)
    for outline in outlines:
        found |= outline.holds(x, y)
    return found


def _texture(world: World, between: tuple[float, float], number: int, shape: tuple[int, ...]) -> Floats:
    """A smooth texture (rows, cols) of albedo between two values, even in its logarithm."""
    low, high = np.log(between)
    rng = np.random.default_rng([world.seed, number])
    knots = rng.uniform(low, high, tuple(2 + max(2, n // 32) for n in world.size)).astype(np.float32)
    smooth = cv2.resize(knots, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.exp(np.clip(smooth, low, high)), np.float32)


def light(
    world: World,
    seen: Samples,
    sequence: Sequence,
    away: Deviation = PLAIN,
    rng: np.random.Generator | None = None,
) -> Floats:
    """Levels (N, H, W) without noise and rounding, in which every frame of a sequence comes to the camera.

    seen: `sampled` with any count; with one sample per pixel the optics spread nothing. rng: of flicker.
    """
    rows, cols = world.size
    count = seen.u.shape[0] // (rows + 2 * MARGIN)
    width = world.scale / count if count > 1 else 0.0
    tables = [_seen(np.asarray((table / 255) ** away.gamma), width) for table in sequence.tables()]
    places = [_cells(seen, table.shape[1], axis, 0.0) for axis, table in enumerate(tables)]
    ghosts = [_cells(seen, table.shape[1], axis, away.apart[axis]) for axis, table in enumerate(tables)]
    still = _read(seen.other, world, count)
    frames = np.empty((len(sequence), rows, cols), np.float32)
    for i in range(len(sequence)):
        shown = _shown(sequence, tables, places, i)
        if away.ghost:
            shown = shown + np.float32(away.ghost) * _shown(sequence, tables, ghosts, i)
        frames[i] = _read(shown * seen.projected, world, count)
    if away.lag:
        frames[1:] = (1 - away.lag) * frames[1:] + away.lag * frames[:-1]
    if away.flicker and rng is not None:
        turn = rng.uniform(0, 2 * math.pi, len(sequence))
        frames *= (1 + away.flicker * np.sin(turn)).astype(np.float32)[:, None, None]
    return frames + still


def _seen(table: NDArray[np.float64], width: float) -> Floats:
    """Means of brightness (N, cells) over `width` cells about FINE places in each cell, (N, FINE cells)."""
    fine, reach = np.repeat(table, FINE, axis=1), round(0.5 * width * FINE)
    return np.asarray(ndimage.uniform_filter1d(fine, 2 * reach + 1, axis=1, mode="nearest"), np.float32)


def _cells(seen: Samples, fine: int, axis: int, apart: float) -> NDArray[np.int64]:
    """Places in tables of `fine` entries."""
    coord = (seen.u, seen.v)[axis] + np.float32(apart + 0.5)
    return np.asarray(np.clip(coord * FINE, 0, fine - 1), np.int64)


def _shown(sequence: Sequence, tables: list[Floats], places: list[NDArray[np.int64]], index: int) -> Floats:
    """Brightness 0..1 of a frame at the samples."""
    axis = sequence.frames[index].axis
    along_u, along_v = (table[index] for table in tables)
    if axis == "v":
        return np.asarray(along_v[places[1]])
    if axis == "u" or axis is None:
        return np.asarray(along_u[places[0]])
    return np.asarray(along_u[places[0]] * along_v[places[1]])


def _read(samples: Floats, world: World, count: int) -> Floats:
    """Means over the pixels, after the optics' point spread."""
    if count > 1:
        rows, cols = (n // count for n in samples.shape)
        spread = cv2.GaussianBlur(samples, (0, 0), count * world.spread, borderType=cv2.BORDER_REPLICATE)
        samples = np.asarray(cv2.resize(spread, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)
    return inside(samples)


def inside(image: NDArray[T], count: int = 1) -> NDArray[T]:
    """The image (n H, n W) without its margin."""
    around = slice(count * MARGIN, -count * MARGIN)
    return image[around, around]
