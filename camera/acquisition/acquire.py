"""One image for every pattern: the first complete one whose exposure began after its pattern had settled.

A pure function of a clock, a display and a camera: simulated time drives the same lines. An image without
a stamp may have been exposed as much before its arrival as the camera's longest hiccup; where there are such
hiccups, the next image must agree with it, and it must differ from that of the pattern before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from optolever.errors import InputError
from optolever.projector import Camera, CameraLost, Display, Image, Shown, Time

from .arrivals import Arrivals, OnImage
from .clocks import ClockMap, Stamp
from .sync_result import SAFE_WAIT_S, Timing

__all__ = ["Taken", "acquire"]

_REPEATS = 3
_WARM_S, _WARM_IMAGES = 2.0, 30  # before the first pattern, for the map of the camera's clock
_PERIOD_S = 0.2  # of a camera whose rate is not known
_HICCUP_S = 0.01  # of a camera without stamps, from which on images are compared
_STRIDE = 2  # of the pixels that are compared
_MIXED = 0.02  # share of the pattern before in an image, at most


@dataclass(frozen=True, slots=True)
class Taken:
    """The image of a pattern. swapped_s, stamp_s: host times of the swap and of the image; repeats: how
    often the pattern was repeated; refused: images before it, by reason ("early", "incomplete").
    """

    index: int
    image: Image
    swapped_s: float
    stamp_s: float
    repeats: int
    refused: Mapping[str, int]


def acquire(
    display: Display,
    camera: Camera,
    timing: Timing | None,
    order: Iterable[int],
    *,
    time: Time,
    clock: ClockMap,
    triggered: bool = False,
    on_image: OnImage | None = None,
    on_shown: Callable[[Shown], None] | None = None,
) -> Iterator[Taken]:
    """Show the frames of `order` one after the other and take an image of each from a camera that runs.

    timing: as measured by `synchronise`; None waits 0.5 s after every swap. triggered: the camera waits for
    `trigger`. on_image, on_shown: called with every image (and its time), accepted or not, and every swap.
    A pattern is repeated if no image comes for three periods and the read-out, or no complete one that long
    after it settled; three times, then InputError. CameraLost comes through.
    """
    ready_s, image_s = SAFE_WAIT_S, 3 * _PERIOD_S
    if timing is not None:
        ready_s, image_s = timing.ready_s(), 3 * timing.period_s + timing.exposure_s + timing.read_out_s
    taking = _Taking(Arrivals(camera, time, clock, triggered, on_image, display), ready_s, image_s)
    taking.warm()
    for index in order:
        refused = {"early": 0, "incomplete": 0}
        for repeats in range(_REPEATS + 1):
            shown = display.show(index)
            if on_shown is not None:
                on_shown(shown)
            found = taking.image_of(shown, refused)
            if found is not None:
                image, stamp = found
                yield Taken(index, image, shown.swapped_s, stamp.time_s, repeats, refused)
                break
        else:
            missing = f"camera: no image of frame {index}, shown {_REPEATS + 1} times"
            if not any(refused.values()):
                raise CameraLost(f"{missing}: unplugged, or without power")
            counts = f"{refused['early']} too old, {refused['incomplete']} incomplete"
            raise InputError(f"{missing} (refused: {counts}); is the camera running, is its rate right?")


@dataclass(slots=True)
class _Taking:
    """ready_s: from a swap to the first good stamp; image_s: for an image that must come, from then on;
    lead_s: a stamp is so much later than its trigger, at least; before: frame and image accepted last.
    """

    arrivals: Arrivals
    ready_s: float
    image_s: float
    lead_s: float = 0.0
    before: tuple[int, Image] | None = None

    def warm(self) -> None:
        """Images for the map of the camera's clock: a map from a handful may be as late as the latest."""
        clock, limit = self.arrivals.clock, self.arrivals.time.now() + _WARM_S
        for image, _ in self.arrivals.until(limit) if clock.images < _WARM_IMAGES else ():
            if image.device_s in (None, image.arrived_s) or clock.images >= _WARM_IMAGES:
                return  # there is no such clock, or it is this computer's

    def _patience(self) -> float:
        return self.image_s + self.arrivals.clock.hiccup_s

    def image_of(self, shown: Shown, refused: dict[str, int]) -> tuple[Image, Stamp] | None:
        """The image of a frame after its swap; None if no good one came."""
        ready, share = shown.swapped_s + self.ready_s, 0.0
        for _ in range(_REPEATS):
            found = self._settled(ready, refused)
            if found is None:
                return None
            image, stamp = found
            share = (
                0.0
                if stamp.trusted or stamp.late_s < _HICCUP_S
                else self._share_of_before(shown.index, image)
            )
            if share <= _MIXED:
                break
            refused["early"] += 1
            ready = self.arrivals.time.now() + stamp.late_s
        if _MIXED < share < 1:
            return None
        self.before = shown.index, image  # one that goes on looking like that of the frame before does
        return image, stamp

    def _settled(self, ready: float, refused: dict[str, int]) -> tuple[Image, Stamp] | None:
        """The first complete image whose exposure began at `ready` or later."""
        arrivals, time = self.arrivals, self.arrivals.time
        limit = sent = ready
        if arrivals.triggered:
            time.wait(ready - self.lead_s)
            sent = arrivals.camera.trigger()
        limit = sent + self._patience()
        while True:
            found = arrivals.stamped(limit)
            if found is None:
                if arrivals.triggered or time.now() >= limit:
                    return None
                continue
            image, stamp = found
            early = stamp.time_s < ready + stamp.late_s
            if image.complete and not early:
                if arrivals.triggered:
                    self.lead_s = min(max(stamp.time_s - sent, 0.0), self.lead_s or float("inf"))
                return found
            refused["early" if image.complete else "incomplete"] += 1
            if arrivals.triggered and (stamp.time_s >= sent or not image.complete):
                self.lead_s, sent = 0.0, arrivals.camera.trigger()
                limit = sent + self._patience()
            elif stamp.time_s - stamp.late_s >= ready + self._patience():
                return None
            else:  # as long as images come, however old, a good one will
                limit = max(limit, time.now() + self._patience())

    def _share_of_before(self, index: int, image: Image) -> float:
        """Share of the frame before in an image, by the next one; 1 where that is as the frame before."""
        following = next(
            (
                one
                for one, _ in self.arrivals.until(self.arrivals.time.now() + self._patience())
                if one.complete
            ),
            None,
        )
        if following is None or self.before is None or self.before[0] == index:
            return 0.0
        seen, again, before = (
            one.pixels[::_STRIDE, ::_STRIDE].astype(np.float64) for one in (image, following, self.before[1])
        )
        change, moved = again - before, seen - again
        noise, power = float(np.mean(moved**2)) / 2, float(np.mean(change**2))
        if power < 3 * noise + 1e-9:
            return 1.0
        return abs(float(np.mean(moved * change)) + noise) / power  # noise of `again` is in both
