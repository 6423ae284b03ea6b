"""The decoder's errors beside what noise allows: bounds, orders, error bars, responses.

Light is computed in float64 from the definitions of the codes, without any of the package's tables; bounds
and orders are of levels that are not rounded, the rest of whole ones.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc
from scipy.stats import mannwhitneyu

from optolever.decode import Correspondence, Response, decode
from optolever.experiments.arrays import Floats
from optolever.experiments.metrics import rms
from optolever.patterns import Sequence, sequence

from .figures import Figure
from .ideal import camera_frames, ideal_level

#: Frames of what Monte Carlo tells: rows, columns; surface of these, cells; seeds of means over seeds.
PIXELS, EXTENT, SEEDS = (600, 1000), 1260, 4
OFFSET, AMPLITUDE = 120.0, 60.0  # levels
RATIOS = (4.5, 10.0, 40.0)  # amplitude over noise
TELLING = 10_000  # scores that tell a share to half a percent
#: Deviations of counting within which a share is what it is expected to be.
COUNTED = 3.0


def decode_errors() -> Iterator[Figure]:
    """Figures of all parts, of images of their own sizes."""
    for part in (_bound, _orders, _doubt, _coverage, _cells, _responses):
        yield from part()


def _light(shown: Sequence, place: tuple[Floats, Floats]) -> Floats:
    """0..1, (N, H, W)."""
    return np.stack([ideal_level(shown, i, *place) for i in range(len(shown))])


def _shoot(shown: Sequence, place: tuple[Floats, Floats], noise: float, seed: int = 0) -> NDArray[Any]:
    return camera_frames(shown, place, (OFFSET, AMPLITUDE), noise, np.random.default_rng(seed))


def _fringes(counts: tuple[int, ...], steps: int, extent: int = EXTENT) -> Sequence:
    """Of so many periods on the surface each, along u."""
    return sequence("phase", 1, extent, axes="u", steps=steps, counts=counts)


def _along_u(shown: Sequence, noise: float, smooth: bool = False) -> tuple[Correspondence, Floats]:
    """Of places all over the middle of the surface, of a smooth map or with nothing to do with each other,
    levels that are not rounded: decoded, and their truth."""
    rng = np.random.default_rng(1)
    u = rng.uniform(0.05 * shown.cols, 0.95 * shown.cols, PIXELS)
    if smooth:
        rows, cols = (np.linspace(0, 1, size) for size in PIXELS)
        u = (0.05 + 0.89 * cols + 0.01 * rows[:, None]) * shown.cols
    frames = OFFSET + AMPLITUDE * (2 * _light(shown, (u, u)) - 1)
    frames += noise * rng.standard_normal(frames.shape)
    return decode(frames, shown, noise=noise, white_level=1e9, on_cells=False), u


def _bound() -> Iterator[Figure]:
    """sigma_phi = sqrt(2 / N) noise / amplitude: Cramer-Rao."""
    for ratio, limit in ((10.0, 1.01), (4.0, 1.03)):
        worst = 0.0
        for steps in (3, 4, 5, 8, 16):
            shown = _fringes((1,), steps, 64)
            found, u = _along_u(shown, AMPLITUDE / ratio, smooth=True)
            error = (found.u - u + 32) % 64 - 32
            worst = max(worst, rms(error) / (64 / (2 * np.pi) * math.sqrt(2 / steps) / ratio))
        name = f"phase noise over Cramer-Rao, amplitude over noise {ratio:g}, worst of N = 3, 4, 5, 8, 16"
        yield Figure(name, worst, high=limit)


def _orders() -> Iterator[Figure]:
    """erfc(pi / (sqrt 2 sigma_phi sqrt(v1^2 + v2^2))), which takes phases for Gaussian: at amplitudes of 16
    deviations they are (of 8, they are wrong 5 % more often)."""
    counts, steps, ratio = (18, 19), 4, 16.0
    found, u = _along_u(_fringes(counts, steps), AMPLITUDE / ratio)
    wrong = float(np.mean(_is_wrong(found.u - u, counts)))
    told = float(erfc(math.pi / (math.sqrt(2) * math.sqrt(2 / steps) / ratio * math.hypot(*counts))))
    counting = math.sqrt(told * (1 - told) / u.size)
    note = f"{wrong:.5f} and {told:.5f}"
    off = abs(wrong - told) / counting
    yield Figure("wrong orders of 18 and 19 periods off erfc", off, "deviations", high=COUNTED, note=note)


def _is_wrong(error: Floats, counts: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.asarray(np.abs(error) > 0.3 * EXTENT / max(counts))


def _doubt() -> Iterator[Figure]:
    """Of a wrong pixel and a right one, how often is the wrong one more doubtful (area under the ROC)."""
    counts = (9, 10, 11)
    found, u = _along_u(_fringes(counts, 4), 14.0)
    wrong, told = _is_wrong(found.u - u, counts), np.asarray(found.order_error, np.float64)
    pairs = int(wrong.sum()) * int((~wrong).sum())
    area = float(mannwhitneyu(told[wrong], told[~wrong]).statistic) / pairs
    name = "order error of 9, 10 and 11 periods, N = 4, noise 14 of 60"
    yield Figure(f"{name}: area under ROC", area, low=0.97)
    yield Figure(f"{name}: predicted over seen", told.mean() / wrong.mean(), low=0.85, high=1.15)


def _scene(rows: int = 240, cols: int = 320) -> tuple[Floats, Floats]:
    """A smooth map within a surface of `rows` x `cols`, (rows, cols)."""
    row, col = np.mgrid[:rows, :cols].astype(np.float64)
    x, y = col / cols, row / rows
    return cols * (0.04 + 0.9 * x + 0.01 * np.sin(7 * y)), rows * (0.04 + 0.9 * y + 0.01 * np.cos(7 * x))


def _score(found: Correspondence, place: tuple[Floats, Floats]) -> Floats:
    """Errors of both axes over sigma, of pixels without flags."""
    told = (found.u, found.sigma_u, place[0]), (found.v, found.sigma_v, place[1])
    return np.concatenate([((coord - truth) / sigma)[found.good] for coord, sigma, truth in told])


def _coverage() -> Iterator[Figure]:
    """Noise is estimated from the frames."""
    place = _scene()
    for text in ("phase", "gray+phase"):
        shown = sequence(text, *place[0].shape)
        shares = []
        for ratio in RATIOS:
            frames = (_shoot(shown, place, AMPLITUDE / ratio, seed) for seed in range(SEEDS))
            scores = [_score(decode(each, shown, on_cells=False), place) for each in frames]
            score = np.abs(np.concatenate(scores))
            if score.size < TELLING:  # bits without inverses are no longer sure
                continue
            shares.append([100 * float(np.mean(score < k)) for k in (1, 2)])
        note = f"amplitude over noise {', '.join(f'{ratio:g}' for ratio in RATIOS)}"
        for k, low, high in ((1, 66.3, 70.3), (2, 94.4, 96.4)):
            some = [share[k - 1] for share in shares]
            for which, value in (("least", min(some)), ("most", max(some))):
                yield Figure(f"{text}, within {k} sigma, {which}", value, "%", low=low, high=high, note=note)


def _cells() -> Iterator[Figure]:
    rows, cols = 240, 320
    row, col = np.mgrid[:rows, :cols].astype(np.float64)
    place = 3 + 0.981 * col + 0.0037 * row, 3 + 0.973 * row + 0.0053 * col
    for text in ("gray", "binary"):
        shown = sequence(text, rows, cols)
        found = decode(_shoot(shown, place, 8.0), shown)
        outside = np.abs(found.u - place[0])[found.good] > 1.5
        stated = float(np.mean(np.asarray(found.order_error)[found.good]))
        counting = math.sqrt(max(stated, 1 / outside.size) / outside.size)
        yield Figure(f"{text}, rms(error) / sigma", rms(_score(found, place)), low=0.95, high=1.05)
        more = (float(outside.mean()) - stated) / counting
        name = f"{text}, pixels off by more than a cell beyond those stated"
        yield Figure(name, more, "deviations", high=COUNTED, note=f"{outside.mean():.1e} and {stated:.1e}")


def _responses() -> Iterator[Figure]:
    """Errors with gamma and clipping handled, over those without them."""
    place = _scene()
    shown = sequence("gray+phase", *place[0].shape, steps=8)
    light = _light(shown, place)
    noise = np.random.default_rng(2).standard_normal(light.shape)

    def error(levels: Floats, response: Response | None, top: float) -> float:
        frames = np.clip(np.rint(levels + noise), 0, top).astype(np.uint8 if top == 255 else np.uint16)
        white = None if response else top
        found = decode(frames, shown, response=response, white_level=white, on_cells=False)
        return rms((found.u - place[0])[found.good])

    plain = error(10 + 230 * light, None, 255.0)
    given = np.linspace(0, 255, 256)
    response = Response.from_table(given, 10 + 230 * (given / 255) ** 2.2)
    bent = error(10 + 230 * light**2.2, response, 255.0)
    yield Figure("error with gamma 2.2, inverted, over that without", bent / plain, high=1.5)
    bright = 10 + 290 * light
    clipped, whole = error(bright, None, 255.0), error(bright, None, 65535.0)
    yield Figure("error with levels up to 300 clipped at 255, over that without", clipped / whole, high=1.5)
