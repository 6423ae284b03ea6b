"""One frame to a height: alternating steps of the image model and of the mirror until convergence.

Every frame starts from rest: a state with holes or wrong fringe orders would persist from frame to frame."""

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np

from optolever.arrays import Cells, Frame, Mask
from optolever.kernels import kernel

from .chord import Linearised, chord_step
from .picture import Carriers, Fit, State, fit_step
from .unwrap import beside_tears, torn, unwrapped

__all__ = ["COMPRESSED", "LEAST_SHARE", "Rig", "Settled", "rest_state", "settle"]

_f4 = np.float32
LEAST_SHARE = 0.15  # illuminated share of a window on the pattern: a corner's window has a quarter
_WHOLE = 0.99
_CONTRAST = 0.15  # of that at rest, in the same light: below it a window has no fringe
_AMPLITUDE = 6.0  # minimum amplitude in standard deviations
_MISFIT = 6.0  # mean square residual over the median one, at which a cell has half weight
COMPRESSED = 0.25  # Jacobian of the map over that at rest: below it the map is about to fold
_NOT_MOVED = 0.2  # predicted change by further steps in sigma, at convergence
_STEPS, _FEWEST = 6, 2
_WRAPPED = 2  # steps after which the displacement is whole
_REST_STEPS = 120
_KINKED, _KINK_STEPS = 0.3, 5  # the same at kinks, rms, which converge slowly; steps for them at most
_HOLE, _HOLE_STEPS = 20, 4  # cells without a fringe from which on up to so many steps go by weights
_SPARSE = 4  # stride of the pixels that measure the light
_LIGHTER, _LAMP, _DARK = 0.01, 0.03, 0.1  # relative change of light to rescale by, to add; least factor
_FILL = 4.0  # cells: radius of the interpolation of displacement into gaps


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Constants of a rig at rest for the chain.

    rest: state of the image model at rest; noise: variance of a grey value at rest; gradient (4, R, C): of
    the rest map in periods, du and dv along columns, then along rows; normal (R, C): z per mm along the ray;
    rim: cells along the border of the illuminated area."""

    carriers: Carriers
    mirror: Linearised
    rest: State
    noise: float
    gradient: Annotated[Cells, "4 R C"]
    normal: Annotated[Cells, "R C"]
    rim: Annotated[Mask, "R C"]

    @property
    def lit(self) -> Mask:
        """Cells whose window has enough of the pattern in view at rest."""
        return np.asarray(self.carriers.share > LEAST_SHARE)

    @property
    def whole(self) -> Mask:
        """Cells whose whole window has the pattern in view at rest."""
        return np.asarray(self.carriers.share > _WHOLE)


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """The fit of a frame. tau (R, C): distance along the rays less that at rest, mm; good: cells with a
    measured height; contrast (R, C): over that at rest, in the same light; strength (R, C): amplitude over
    that at rest; residual (R, C): mean square, levels^2; ahead (R, C): predicted change of z by further steps
    and by the weights at kinks, mm; left: predicted typical change by further steps, in sigma; usual: median
    of the mean square residual; slopes (2, R, C): less those at rest; jacobian: of the map over that at rest,
    the least."""

    state: State
    tau: Cells
    good: Mask
    contrast: Cells
    strength: Cells
    residual: Cells
    ahead: Cells
    left: float
    usual: float
    slopes: Cells
    steps: int
    jacobian: float


def settle(rig: Rig, frame: Frame, sigma: Cells) -> Settled:
    """Fit a frame. sigma (R, C): of z, mm, for the criterion of convergence."""
    state, tau = _lighted(rig, rig.rest, frame), np.zeros(rig.carriers.shape, _f4)
    seen = rig.carriers.by_columns(frame)
    sizes: list[float] = []
    kinks: list[float] = []
    some = np.s_[::3, ::3]
    evenly, fewest = np.ones_like(tau), _FEWEST  # gaps are filled; the last step weighs
    for step in range(_STEPS):
        state, fit = fit_step(rig.carriers, seen, state)
        good, contrast, strength = _good(rig, state, fit)
        offset = state.displacement - rig.rest.displacement
        if step < _WRAPPED and torn(offset, good):
            fewest = _FEWEST + 1
            offset, good = unwrapped(offset, good, rig.rim)
            state.displacement[:] = offset + rig.rest.displacement
        if not good.all():
            _fill(rig, state, good)
            offset = state.displacement - rig.rest.displacement
        change, slopes = chord_step(rig.mirror, offset, tau, evenly)
        tau += change
        change *= rig.normal
        ratios = (np.abs(change[some]) / sigma[some])[good[some]]
        if ratios.size == 0:
            sizes, kinks, slow = [np.inf], [np.inf], 0.5
            break
        sizes.append(1.48 * float(np.median(ratios)))
        kinks.append(float(np.sqrt(np.mean(np.square(ratios)))))
        pace, slow = (min(of[-1] / of[-2], 0.8) if step and of[-2] > 0 else 0.8 for of in (sizes, kinks))
        kinked = kinks[-1] * slow / (1 - slow) > _KINKED and step + 1 < _KINK_STEPS
        if step + 1 >= fewest and sizes[-1] * pace / (1 - pace) < _NOT_MOVED and not kinked:
            break
    left = sizes[-1] * pace / (1 - pace) if np.isfinite(sizes[-1]) else np.inf
    # the residual is evaluated after convergence: before, it is large wherever something moved
    residual = fit.residual(rig.carriers)  # of cells that are not lit: 0
    usual = float(np.median(residual[some][rig.lit[some]]))
    ratio = _compressions(rig.gradient, offset)
    least = float(ratio[good].min(initial=1.0))
    if ratio.min() < COMPRESSED:  # also cells whose window reaches there
        reach = rig.carriers.window.size // 3
        folded = (ratio < COMPRESSED).astype(np.uint8)
        good &= cv2.dilate(folded, np.ones((reach, reach), np.uint8)) == 0
    if torn(offset, good):
        good &= ~beside_tears(offset)
    if not good.all():
        good = _anchored(rig, good)
    ahead = np.abs(change) * _f4(slow / (1 - slow))
    trust = good / (1 + np.square(residual / _f4(_MISFIT * max(usual, rig.noise))))
    holes = np.count_nonzero(rig.lit & ~good) > _HOLE
    # kinks have a small weight, but must not detach the area that they enclose
    for _ in range(_HOLE_STEPS if holes else int(trust.min() < 0.5)):
        more, slopes = chord_step(rig.mirror, offset, tau, trust.astype(_f4))
        tau += more
        more = np.abs(more * rig.normal)
        ahead = np.hypot(ahead, more)
        if float(np.square(more / sigma)[good].sum()) < _NOT_MOVED**2 * np.count_nonzero(good):
            break
    if holes:  # what fills them moves from step to step: the solution by weights is what converges
        ahead = more
        left = 1.48 * float(np.median((ahead / sigma)[good])) if good.any() else np.inf
    return Settled(
        state, tau, good, contrast, strength, residual, ahead, left, usual, slopes, len(sizes), least
    )


def _lighted(rig: Rig, state: State, frame: Frame) -> State:
    """The state in the frame's light: scaled by the display's, its level tilted by a lamp's. Truncated
    windows would take many steps to converge to it."""
    few = np.s_[::_SPARSE, ::_SPARSE]
    lit, grey = rig.carriers.lit[few] > 0, frame[few]
    gain = float(grey[lit].mean()) / max(float(state.level[rig.lit].mean()), 1.0)
    if not _DARK < gain < 1 / _DARK:
        return state
    planes = state.planes.copy()
    if abs(gain - 1) > _LIGHTER:
        planes[2:] *= _f4(gain)
    level: Cells = planes[2]
    more = (grey - cv2.resize(level, grey.shape[::-1]))[lit]
    basis = [np.broadcast_to(part, grey.shape)[lit] for part in _ramps(*grey.shape)]
    tilt = np.linalg.solve(np.inner(basis, basis), np.inner(basis, more)).astype(_f4)
    if np.abs(tilt).sum() > _LAMP * level.mean():
        for size, ramp in zip(tilt, _ramps(*level.shape), strict=True):
            level += size * ramp
    return State(planes)


def _ramps(rows: int, cols: int) -> tuple[Cells, Cells, Cells]:
    """A constant, a ramp along columns, one along rows."""
    along, down = (np.linspace(-1, 1, count, dtype=_f4) for count in (cols, rows))
    return np.ones((1, 1), _f4), along[None], down[:, None]


def rest_state(carriers: Carriers, mean: Frame, start: State) -> State:
    """The fit of frames at rest, as far as that of moving ones comes in time; mean (H, W): of such frames."""
    state, seen = start, carriers.by_columns(mean)
    for _ in range(_REST_STEPS):
        state, _ = fit_step(carriers, seen, state)
    return state


def _good(rig: Rig, state: State, fit: Fit) -> tuple[Mask, Cells, Cells]:
    """Cells with a fringe, their contrast and strength (see Settled)."""
    size = float(np.square(rig.carriers.window).sum()) / rig.carriers.cell
    least = _f4(_AMPLITUDE * float(np.sqrt(2 * rig.noise)) * size)
    contrast, strength = np.empty((2, *fit.share.shape), _f4)
    good = np.empty(fit.share.shape, np.bool_)
    _judged(state.planes, rig.rest.planes, rig.carriers.share, fit.share, least, good, contrast, strength)
    return good, contrast, strength


@kernel
def _judged(planes, rest, lit, share, least, good, contrast, strength):  # type: ignore[no-untyped-def]
    """See `_good`; planes, rest (5, R, C): states."""
    tiny, most = _f4(1e-3), _f4(LEAST_SHARE)
    for i in range(good.shape[0]):
        for j in range(good.shape[1]):
            a, b = planes[3, i, j], planes[4, i, j]
            light = max(planes[2, i, j] / max(rest[2, i, j], _f4(1)), _f4(0.05))
            size = min(a / max(rest[3, i, j], tiny), b / max(rest[4, i, j], tiny))
            strength[i, j], contrast[i, j] = size, size / light
            seen = (lit[i, j] > most) & (share[i, j] > most) & (min(a, b) > least)
            good[i, j] = seen & (size > _f4(_CONTRAST) * light)


def _fill(rig: Rig, state: State, good: Mask) -> None:
    """Interpolate the state of cells without a fringe from surrounding ones, as a start for the next step."""
    x, y, width, height = cv2.boundingRect((~good).astype(np.uint8))
    reach = int(4 * _FILL) + 1  # of the blur
    box = slice(max(y - reach, 0), y + height + reach), slice(max(x - reach, 0), x + width + reach)
    here, bad = good[box], ~good[box]
    weight = cv2.GaussianBlur(here.astype(_f4), (0, 0), _FILL) + _f4(1e-6)
    for plane, rest in zip(state.planes[:, *box], rig.rest.planes[:, *box], strict=True):
        around = cv2.GaussianBlur(np.where(here, plane - rest, _f4(0)), (0, 0), _FILL) / weight
        plane[bad] = (around + rest)[bad]


def _anchored(rig: Rig, good: Mask) -> Mask:
    """Cells connected to an anchor: the height of an island is known only up to a constant."""
    count, labels = cv2.connectedComponents(good.astype(np.uint8), connectivity=4)
    reached = np.zeros(count, np.bool_)
    reached[labels[(rig.mirror.anchor[0] > 0) & good]] = True
    return np.asarray(reached[labels] & good)


@kernel
def _compressions(gradient, offset):  # type: ignore[no-untyped-def]
    """Jacobian of the map (R, C) over that at rest; 1 at the ends."""
    ratio, half = np.ones(offset.shape[1:], np.float32), _f4(0.5)
    for i in range(1, ratio.shape[0] - 1):
        for j in range(1, ratio.shape[1] - 1):
            a, b, c, d = gradient[0, i, j], gradient[1, i, j], gradient[2, i, j], gradient[3, i, j]
            at_rest = a * d - b * c
            a += half * (offset[0, i, j + 1] - offset[0, i, j - 1])
            b += half * (offset[1, i, j + 1] - offset[1, i, j - 1])
            c += half * (offset[0, i + 1, j] - offset[0, i - 1, j])
            d += half * (offset[1, i + 1, j] - offset[1, i - 1, j])
            ratio[i, j] = (a * d - b * c) / at_rest
    return ratio
