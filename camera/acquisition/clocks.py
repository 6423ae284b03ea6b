"""Stamps of a camera's clock as times of this computer."""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from optolever.projector import Image

__all__ = ["ClockMap", "Stamp"]

_SPAN_S = 60.0  # images that count
_BLOCK_S = 1.0  # one of them a second: the one that arrived with the least delay
_DRIFT = 1e-4  # of a crystal, at most
_DRIFT_SPAN_S = 30.0  # below, a line through the least delays is worse than none
_WAITS = 1000
_EARLY_S, _LATE_S = 1.0, 2.0  # a stamp after, and before, the arrival, at most


@dataclass(frozen=True, slots=True)
class Stamp:
    """Time of an image and its standard deviation, s; trusted: by the camera's clock, else by its arrival;
    late_s: how much earlier its exposure may have been.
    """

    time_s: float
    sigma_s: float
    trusted: bool
    late_s: float = 0.0


class ClockMap:
    """Device time to host time by the images that arrived with the least delay.

    That delay's constant part stays in the stamps: `synchronise` measures latency with the same stamps, so
    it cancels. The drift is 0 until the images span 30 s, then that of the lower envelope, at most 100 ppm.
    """

    def __init__(self) -> None:
        self._blocks: deque[tuple[float, float]] = deque()  # device time, least arrival - device time
        self._last: float | None = None
        self._odd: tuple[float, float] | None = None  # device time and delay of a stamp that does not fit
        self._line = 0.0, 0.0, 0.0  # device time, offset, drift
        self._mean_excess, self._count = 0.0, 0
        self._waits: deque[float] = deque(maxlen=_WAITS)  # for images, s
        self._asked: float | None = None
        self.distrusted = 0

    @property
    def hiccup_s(self) -> float:
        """By how much the longest wait for an image without a stamp exceeds the usual one."""
        return max(self._waits) - median(self._waits) if self._waits and not self._count else 0.0

    def ask(self, time_s: float) -> None:
        """Note the start of a wait for an image, unless one is under way."""
        self._asked = time_s if self._asked is None else self._asked

    def stamp(self, image: Image) -> Stamp:
        """Add an image to the map; returns its time. Stamps that do not rise, or that lie more than 1 s after
        or 2 s before their arrival, are not trusted: arrival counts instead, `distrusted` counts them. Two in
        a row that agree are a clock that was set: the map begins anew.
        """
        device, arrived = image.device_s, image.arrived_s
        if self._asked is not None:
            self._waits.append(arrived - self._asked)
            self._asked = None
        if device is None:
            return Stamp(arrived, 0.0, trusted=False, late_s=self.hiccup_s)
        delay = arrived - device
        rises = self._last is None or device > self._last
        ahead = 0.0 if self._last is None else self.host(device)[0] - arrived
        if not rises or ahead > _EARLY_S:
            odd, self._odd = self._odd, (device, delay)
            if odd is None or device <= odd[0] or abs(delay - odd[1]) > _EARLY_S:
                return self._by_arrival(arrived)
            self._blocks.clear()
            self._mean_excess, self._count = 0.0, 0
            self._add(*odd)
        elif ahead < -_LATE_S:  # late in a queue: no image of what was shown since
            return self._by_arrival(arrived, -ahead)
        self._last, self._odd = device, None
        self._add(device, delay)
        time, sigma = self.host(device)
        return Stamp(time, sigma, trusted=True, late_s=3 * sigma)

    def _by_arrival(self, arrived: float, late_s: float = 0.0) -> Stamp:
        self.distrusted += 1
        return Stamp(arrived, 0.0, trusted=False, late_s=max(late_s, self.hiccup_s))

    @property
    def images(self) -> int:
        """How many stamps it knows."""
        return self._count

    def host(self, device_s: float) -> tuple[float, float]:
        """Time and standard deviation, s, of a device time."""
        at, offset, drift = self._line
        span = abs(device_s - at)
        unknown = (0.1 if drift else 1.0) * _DRIFT / 3**0.5 * span  # uniform between the limits
        excess = self._mean_excess / max(self._count, 1)
        return device_s + offset + drift * (device_s - at), float((unknown**2 + excess**2) ** 0.5)

    def _add(self, device: float, delay: float) -> None:
        blocks, before = self._blocks, self.host(device)[0]
        self._count += 1
        if not blocks or device - blocks[-1][0] > _BLOCK_S:
            blocks.append((device, delay))
        elif delay < blocks[-1][1]:
            blocks[-1] = device, delay
        while blocks[-1][0] - blocks[0][0] > _SPAN_S:
            blocks.popleft()
        self._line = _lower_line(list(blocks))
        now = self.host(device)[0]
        if self._count > 1:  # excesses count from the line of now
            self._mean_excess += before - now
        excess = max(device + delay - now, 0.0)
        self._mean_excess += (excess - self._mean_excess) / min(self._count, 1000)


def _lower_line(points: list[tuple[float, float]]) -> tuple[float, float, float]:
    """The line below all points that is nearest to them: a time, its offset there, its drift."""
    drift = 0.0
    if points[-1][0] - points[0][0] >= _DRIFT_SPAN_S:
        mean = sum(point[0] for point in points) / len(points)
        hull = _lower_hull(points)
        for (x0, y0), (x1, y1) in pairwise(hull):
            if x0 <= mean <= x1:
                drift = min(max((y1 - y0) / (x1 - x0), -_DRIFT), _DRIFT)
                break
    at, lowest = min(points, key=lambda point: point[1] - drift * point[0])
    return at, lowest, drift


def _lower_hull(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Lower convex hull of points in the order of their first coordinate."""
    hull: list[tuple[float, float]] = []
    for point in points:
        while len(hull) > 1 and _turn(hull[-2], hull[-1], point) <= 0:
            hull.pop()
        hull.append(point)
    return hull


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
