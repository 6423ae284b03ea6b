"""Light of a drawn rig's frames, and a camera that sees them: no formula of the decoder."""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from optolever.patterns import Frame, Sequence, sequence_from_text
from optolever.scene import trace

from .rigs import F64, MARGIN, SIZE, Mask, Rig, grown, pixels, rays_of

F32 = NDArray[np.float32]
FINE = 32  # samples of a cell's light


@dataclass(frozen=True)
class World:
    """What is otherwise than in a clean capture; shares unless said.

    critical: the rig, see draw_rig; cells: the display's blur (cells; 0: the rig's); gamma; lens, camera px
    rms (None: drawn), known to the decoder where `told`; lag: of the frame before;
    flicker: rms of the frames' brightness; growth: of the dent from first to last frame; vignetting: of the
    light in the corners; haze: of the light, scattered over 15 px; row_noise: levels rms, common to a row;
    sharpen: of an unsharp mask of 1 px; jpeg: quality (0: none); white: levels; dark: rows of the image that
    see no mirror; interleaved: u and v in turn; order: wrong order of frames (see `shuffled`).
    """

    critical: bool = False
    cells: float = 0.0
    gamma: float = 1.0
    lens: float | None = None
    told: bool = False
    lag: float = 0.0
    flicker: float = 0.0
    growth: float = 0.0
    vignetting: float = 0.0
    haze: float = 0.0
    row_noise: float = 0.0
    sharpen: float = 0.0
    jpeg: int = 0
    white: float = 0.0
    dark: float = 0.0
    interleaved: bool = False
    order: str = ""


@dataclass(frozen=True, eq=False)
class Shot:
    """frames (N, H, W) described by `sequence`; truth: at the moment of the heights; lit (H, W); wrong:
    numbers of the first two pictures that are not the frames described.
    """

    frames: NDArray[np.uint8]
    sequence: Sequence
    truth: dict[str, F64]
    lit: Mask
    wrong: tuple[int, ...] = ()


def shoot(rig: Rig, code: str, world: World, seed: int = 0) -> Shot:
    """A camera of 8 bits with photon noise (10 to 100 e/level), read noise and an offset sees a rig."""
    rng, optics_rng, order_rng = np.random.default_rng([seed, *rig.name.encode()]).spawn(3)
    described = sequence_from_text(code, rig.scene.pattern.rows, rig.scene.pattern.cols)
    if world.interleaved:
        described = _interleaved(described)
    shown, order = shuffled(described, world.order, order_rng)
    drawn = float(optics_rng.choice([0.0, 0.0, 0.2, 0.4]))
    lens = drawn if world.lens is None else world.lens
    optics = World(
        cells=world.cells, gamma=world.gamma, growth=world.growth, lens=lens, vignetting=world.vignetting
    )
    light, lit = _light(rig, shown, optics)
    light, lit = light[list(order)], lit.copy()
    if world.dark:
        hidden = slice(0, round(world.dark * SIZE[0]))
        light[:, hidden], lit[hidden] = 0.0, False
    if world.haze:
        scattered = np.stack([gaussian_filter(one, 15.0) for one in light])
        light = light + np.float32(world.haze) * (scattered - light)
    light = light * (1 + world.flicker * rng.standard_normal((len(light), 1, 1))).astype(np.float32)
    if world.lag:
        light[1:] += np.float32(world.lag) * (light[:-1] - light[1:])
    black, white = float(rng.uniform(4, 20)), world.white or float(rng.uniform(120, 225))
    electrons, read = float(np.exp(rng.uniform(*np.log([10, 100])))), float(rng.uniform(0.4, 1.2))
    levels = black + (white - black) * light
    spread = np.sqrt(read**2 + np.maximum(levels - black, 0) / electrons)
    levels += spread * rng.standard_normal(levels.shape, np.float32)
    levels += np.float32(world.row_noise) * rng.standard_normal((*levels.shape[:2], 1), np.float32)
    if world.sharpen:
        soft = np.stack([gaussian_filter(one, 1.0) for one in levels])
        levels += np.float32(world.sharpen) * (levels - soft)
    frames = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    if world.jpeg:
        frames = np.stack([_jpeg(one, world.jpeg) for one in frames])
    wrong = tuple(np.flatnonzero(order != np.arange(len(order)))[:2].tolist())
    return Shot(frames, described, _truth(rig, described, world), lit, wrong)


def _truth(rig: Rig, shown: Sequence, world: World) -> dict[str, F64]:
    """Of the mean time of the finest fringes, else of all frames."""
    seen = rig.truth
    if world.growth:
        periods = [one.period_px or np.inf for one in shown.frames]
        finest = [i for i, period in enumerate(periods) if period == min(periods)]
        moment = float(np.mean(finest)) / (len(shown) - 1)
        seen = trace(rig.scene, grown(rig.surface, moment * world.growth))
    return {name: np.asarray(getattr(seen, name), np.float64) for name in "uvxyz"}


@lru_cache(maxsize=3)
def _light(rig: Rig, shown: Sequence, optics: World) -> tuple[F32, Mask]:
    """Light (N, H, W) of SIZE, 1 where a lit pixel sees white; lit."""
    blur = optics.cells or rig.scene.pattern.blur_px
    side = 8 if blur < 0.2 else rig.side
    rays, later = rays_of(rig, side), rays_of(rig, side, optics.growth)
    of_u, of_v = (_profiles(table, blur, optics.gamma) for table in shown.tables())
    light = np.empty((len(shown), *SIZE), np.float32)
    inside, seen = slice(MARGIN, -MARGIN), rays.reflected.astype(np.float32)
    places, motions = (rays.u, rays.v), (later.u - rays.u, later.v - rays.v)
    still: dict[bytes, F32] = {}
    shade = (1 - optics.vignetting * _radius2(seen.shape, MARGIN * side)).astype(np.float32)
    for i in range(len(shown)):
        fine = seen.copy()
        for k, profile in enumerate((of_u[i], of_v[i])):
            key = bytes([k]) + profile.tobytes()
            if optics.growth:
                fine *= _at(profile, places[k] + i / (len(shown) - 1) * motions[k])
            else:
                still[key] = still[key] if key in still else _at(profile, places[k])
                fine *= still[key]
        if optics.lens:
            fine = gaussian_filter(fine, optics.lens * side)
        light[i] = pixels(fine * shade, side).mean(axis=(1, 3))[inside, inside]
    return light, rays.lit & later.lit


def _profiles(table: NDArray[np.uint8], blur: float, gamma: float) -> F64:
    """Light (N, samples) along an axis, FINE samples a cell, MARGIN dark cells at either end."""
    light = np.pad((table / 255.0) ** gamma, ((0, 0), (MARGIN, MARGIN)))
    return np.asarray(gaussian_filter1d(np.repeat(light, FINE, axis=1), blur * FINE, mode="constant"))


def _at(profile: F64, place: F64) -> F32:
    """At places (cells, NaN: dark)."""
    at = (np.nan_to_num(place, nan=-1e6) + 0.5 + MARGIN) * FINE - 0.5
    return np.interp(at, np.arange(profile.size), profile, 0.0, 0.0).astype(np.float32)


def _radius2(size: tuple[int, ...], margin: int) -> F64:
    """0 in the middle, 1 in the corners of the image inside a margin."""
    row, col = (np.arange(count) - 0.5 * (count - 1) for count in size)
    half_rows, half_cols = (0.5 * count - margin for count in size)
    return np.asarray(0.5 * ((row[:, None] / half_rows) ** 2 + (col / half_cols) ** 2))


def _jpeg(frame: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    packed = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE))


def _interleaved(shown: Sequence) -> Sequence:
    """Frames of u and v in turn, after those of no axis."""
    parts = [[one for one in shown.frames if one.axis == axis] for axis in (None, "u", "v")]
    turns = [one for k in range(len(shown)) for part in parts[1:] for one in part[k : k + 1]]
    return replace(shown, frames=(*parts[0], *turns))


def shuffled(described: Sequence, order: str, rng: np.random.Generator) -> tuple[Sequence, NDArray[np.intp]]:
    """The sequence that is shown, and the numbers of its frames in the order of the pictures.

    'swapped': two frames; 'lost': one, the last one twice; 'repeated': one in the place of the next ones, the
    last one lost; 'reversed': all; 'v first': all of v before u; 'bits reversed': finest first; 'inverses
    first'; 'binary': binary bits for Gray bits.
    """
    count = len(described)
    numbers, at = np.arange(count), int(rng.integers(2, count - 2))
    frames = list(described.frames)
    if order == "swapped":
        other = at + 1 if rng.random() < 0.6 else int(rng.choice(np.delete(numbers, at)))
        numbers[[at, other]] = other, at
    elif order == "lost":
        numbers = np.append(np.delete(numbers, at), count - 1)
    elif order == "repeated":
        numbers = np.insert(numbers, at, at)[:-1]
    elif order == "reversed":
        numbers = numbers[::-1]
    elif order == "v first":
        frames.sort(key=lambda one: {None: 0, "v": 1, "u": 2}[one.axis])
    elif order == "inverses first":
        frames = [replace(one, inverted=not one.inverted) if one.bit is not None else one for one in frames]
    elif order in ("bits reversed", "binary"):
        frames = [_other_bit(one, described, order) for one in frames]
    return replace(described, frames=tuple(frames)), numbers


def _other_bit(one: Frame, described: Sequence, order: str) -> Frame:
    if one.bit is None:
        return one
    most = max(each.bit for each in described.frames if each.bit is not None and each.axis == one.axis)
    return replace(one, kind="binary") if order == "binary" else replace(one, bit=most - one.bit)
