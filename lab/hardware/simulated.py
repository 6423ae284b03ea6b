"""A display, a camera and a clock in simulated time, written apart from what is tested with them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.projector import Accepted, Identity, Image, Shown, Wanted

__all__ = [
    "SETTINGS", "Setting", "SimulatedCamera", "SimulatedDisplay", "SimulatedTime", "codes",
    "drawn_setting",
]  # fmt: skip


BLACK, SWING = 20.0, 200.0  # levels
SETTINGS = 20
_COLUMNS = 8
_HICCUPS_S = 0.731


@dataclass(frozen=True)
class Setting:
    """Seconds. rise and fall: time constants; shutter: first to last row; late: share of swaps whose light
    comes a refresh later; lost, incomplete: shares of the images; drift, offset: of the camera's clock;
    buffers: images that the driver holds for who does not pull; rate: images/s;
    behind: images that come that much later; transfer: mean random delay; noise: levels rms of a pixel;
    hiccup: as long nothing arrives, every 0.731 s.
    """

    refresh: float = 1 / 60
    delay: float = 0.010
    rise: float = 0.005
    fall: float = 0.005
    late: float = 0.0
    exposure: float = 1 / 60
    shutter: float = 0.008
    read_out: float = 0.010
    rate: float = 60.0
    transfer: float = 0.0002
    lost: float = 0.0
    incomplete: float = 0.0
    drift: float = 0.0
    offset: float = 1234.5
    buffers: int = 8
    behind: int = 0
    noise: float = 0.0
    trigger: str = "free"
    stamped: bool = True
    hiccup: float = 0.0

    @property
    def period(self) -> float:
        """Between two exposures."""
        return max(1 / self.rate, self.exposure, self.read_out)

    @property
    def bound(self) -> float:
        """Latency, settling, exposure, read-out, a refresh and a period: what a frame cannot do without."""
        settling = np.log(512) * max(self.rise, self.fall)
        return float(self.delay + settling + self.exposure + self.read_out + self.refresh + self.period)


def drawn_setting(rng: np.random.Generator) -> Setting:
    """Displays with vsync at 60 or 120 Hz, cameras with rolling or global shutter, losses, stale queues."""
    refresh = 1 / float(rng.choice([60, 120]))
    read_out = float(rng.uniform(0.002, 0.020))
    return Setting(
        refresh=refresh,
        delay=float(rng.uniform(0.003, 0.025)),
        rise=float(rng.uniform(0.002, 0.015)),
        fall=float(rng.uniform(0.002, 0.015)),
        late=float(rng.choice([0.0, 0.0, 0.1])),
        exposure=int(rng.integers(1, 3)) * refresh,
        shutter=float(rng.choice([-1, 0, 1, 1])) * float(rng.uniform(0.3, 0.95)) * read_out,
        read_out=read_out,
        rate=float(rng.choice([30, 59.3, 90])),
        lost=float(rng.choice([0, 0.01, 0.03])),
        incomplete=float(rng.choice([0, 0.01, 0.03])),
        drift=float(rng.uniform(-5e-5, 5e-5)),
        buffers=int(rng.integers(2, 9)),
    )


@dataclass
class SimulatedTime:
    """Stands still while the program computes."""

    seconds: float = 100.0

    def now(self) -> float:
        """Seconds."""
        return self.seconds

    def wait(self, until: float) -> None:
        """Go there."""
        self.seconds = max(self.seconds, until)


class SimulatedDisplay:
    """patterns (K, 8), 0 to 1: what its columns show. Cells follow exponentially."""

    def __init__(
        self, setting: Setting, time: SimulatedTime, patterns: Floats, rng: np.random.Generator
    ) -> None:
        self._setting, self._time, self.patterns, self._rng = setting, time, patterns, rng
        #: times at which cells begin to move, where they go, where they are then, light until then
        self._moves: list[tuple[float, Floats, Floats, Floats]] = [
            (0.0, patterns[0], patterns[0].copy(), np.zeros(_COLUMNS))
        ]

    @property
    def refresh_s(self) -> float | None:
        """Period."""
        return self._setting.refresh

    def show(self, index: int) -> Shown:
        """Swap at the next vertical blank."""
        one = self._setting
        blank = (np.floor(self._time.now() / one.refresh + 1e-6) + 1) * one.refresh
        self._time.wait(float(blank))
        light = float(blank) + one.delay + (one.refresh if self._rng.random() < one.late else 0.0)
        light = max(light, self._moves[-1][0])
        state, total = self._at(light, self._moves[-1])
        self._moves = [*self._moves[-7:], (light, self.patterns[index], state, total)]
        return Shown(index, float(blank))

    def _at(self, time: float, move: tuple[float, Floats, Floats, Floats]) -> tuple[Floats, Floats]:
        """Light of the cells, and what has come of it so far."""
        begin, target, state, total = move
        since = time - begin
        tau = np.where(target > state, self._setting.rise, self._setting.fall)
        left = np.exp(-since / tau)
        return target + (state - target) * left, total + target * since + (state - target) * tau * (1 - left)

    def light(self, begin: float, end: float) -> Floats:
        """Mean light of the columns (8,) between two times."""
        return (self._total(end) - self._total(begin)) / (end - begin)

    def _total(self, time: float) -> Floats:
        for move in reversed(self._moves):
            if move[0] <= time:
                return self._at(time, move)[1]
        return self._at(time, self._moves[0])[1]


@dataclass
class SimulatedCamera:
    """rows: exposed one after the other, from the top or (shutter < 0) from the bottom."""

    setting: Setting
    time: SimulatedTime
    display: SimulatedDisplay
    rng: np.random.Generator
    rows: int = 2
    lost: int = 0
    _next: int = 0
    _phase: float = 0.0
    _pending: list[Image] = field(default_factory=list)
    _triggers: list[float] = field(default_factory=list)

    @property
    def identity(self) -> Identity:
        """Of no maker."""
        return Identity("simulated", "simulated", "1", "simulated")

    def configure(self, wanted: Wanted) -> Accepted:
        """As the setting says."""
        one = self.setting
        return Accepted(one.exposure, self.rows, _COLUMNS, fps=1 / one.period, trigger=one.trigger)

    def start(self) -> None:
        """At any phase of the display."""
        self._phase = self.time.now() + float(self.rng.uniform(0, self.setting.period))
        self._next = 0

    def trigger(self) -> float:
        """An exposure follows a fifth of a millisecond later, not before the last has been read."""
        self._triggers.append(max(self.time.now() + 2e-4, self._free()))
        return self.time.now()

    def _free(self) -> float:
        return self._triggers[-1] + self.setting.period if self._triggers else 0.0

    def next(self, timeout_s: float) -> Image | None:
        """Images come in order; those that found no buffer never do."""
        limit = self.time.now() + timeout_s
        self._fill(self.time.now())
        while not self._pending:
            begin = self._begin(self._next)
            if begin is None or self._arrival(begin) > limit:
                self.time.wait(limit)
                return None
            self.time.wait(self._arrival(begin))
            self._fill(self.time.now())
        return self._pending.pop(0)

    def stop(self) -> None:
        """Nothing is running."""

    def close(self) -> None:
        """Nothing is open."""

    def _begin(self, number: int) -> float | None:
        if self.setting.trigger == "free":
            return self._phase + number * self.setting.period
        return self._triggers[number] if number < len(self._triggers) else None

    def _arrival(self, begin: float) -> float:
        one = self.setting
        arrival = begin + one.exposure + one.read_out + one.behind * one.period
        return arrival + max(one.hiccup - arrival % _HICCUPS_S, 0.0)

    def _fill(self, now: float) -> None:
        """Take what has arrived by now."""
        one = self.setting
        while (begin := self._begin(self._next)) is not None and self._arrival(begin) <= now:
            number, self._next = self._next, self._next + 1
            arrived = self._arrival(begin) + one.transfer * float(self.rng.exponential())
            if self.rng.random() < one.lost or len(self._pending) >= one.buffers:
                self.lost += 1
                continue
            complete = bool(self.rng.random() >= one.incomplete)
            pixels = self._pixels(begin) if complete else np.empty((0, 0), np.uint8)
            device = begin * (1 + one.drift) + one.offset if one.stamped else None
            self._pending.append(Image(pixels, number + 1, device, arrived, complete))

    def _pixels(self, begin: float) -> NDArray[np.uint8]:
        one, image = self.setting, np.empty((self.rows, _COLUMNS))
        for row in range(self.rows):
            place = row / max(self.rows - 1, 1) if one.shutter >= 0 else 1 - row / max(self.rows - 1, 1)
            start = begin + abs(one.shutter) * place
            image[row] = self.display.light(start, start + one.exposure)
        noise = self.rng.normal(0, one.noise, image.shape) if one.noise else 0.0
        return np.clip(np.rint(BLACK + SWING * image + noise), 0, 255).astype(np.uint8)


def codes(count: int, rng: np.random.Generator) -> Floats:
    """Patterns that differ in some column from all others, and in most from the one before."""
    found = rng.choice(2**_COLUMNS, count, replace=False)
    return ((found[:, None] >> np.arange(_COLUMNS)) & 1).astype(np.float64)
