"""One image for every pattern: the first complete one whose exposure began after its pattern had settled.

A pure function of a clock, a display and a camera: simulated time drives the same lines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from optolever.errors import InputError

from .clocks import ClockMap
from .devices import Camera, Display, Image, Shown, Time
from .timing import SAFE_WAIT_S, Timing

__all__ = ["Taken", "acquire"]

_REPEATS = 3
_WARM_S, _WARM_IMAGES = 2.0, 30  # before the first pattern, for the map of the camera's clock
_PERIOD_S = 0.2  # of a camera whose rate is not known

OnImage = Callable[[Image, float], None]


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


@dataclass(frozen=True, slots=True)
class _Wait:
    """How long to wait: from a swap to the first good stamp; for an image that must come, from then on."""

    ready_s: float
    image_s: float


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
    if timing is None:
        wait = _Wait(SAFE_WAIT_S, 3 * _PERIOD_S)
    else:
        wait = _Wait(timing.ready_s(), 3 * timing.period_s + timing.exposure_s + timing.read_out_s)
    lead = 0.0  # a stamp is so much later than its trigger, at least

    def attempt(index: int, refused: dict[str, int]) -> tuple[Image, Shown, float] | None:
        nonlocal lead
        shown = display.show(index)
        if on_shown is not None:
            on_shown(shown)
        ready = shown.swapped_s + wait.ready_s
        limit = ready + wait.image_s
        if triggered:
            time.wait(ready - lead)
            sent = camera.trigger()
            limit = sent + wait.image_s
        while True:
            image = camera.next(max(limit - time.now(), 0.0))
            if image is None:
                if triggered or time.now() >= limit:
                    return None
                continue
            stamp = clock.stamp(image)
            if on_image is not None:
                on_image(image, stamp.time_s)
            early = stamp.time_s < ready + 3 * stamp.sigma_s
            if image.complete and not early:
                if triggered:
                    lead = min(max(stamp.time_s - sent, 0.0), lead or float("inf"))
                return image, shown, stamp.time_s
            refused["incomplete" if not image.complete else "early"] += 1
            if triggered and (stamp.time_s >= sent or not image.complete):
                lead, sent = 0.0, camera.trigger()
                limit = sent + wait.image_s
            elif stamp.time_s >= ready + wait.image_s:
                return None
            else:  # as long as images come, however old, a good one will
                limit = max(limit, time.now() + wait.image_s)

    _warm(camera, time, clock, triggered, on_image)
    for index in order:
        refused = {"early": 0, "incomplete": 0}
        for repeats in range(_REPEATS + 1):
            found = attempt(index, refused)
            if found is not None:
                image, shown, stamp = found
                yield Taken(index, image, shown.swapped_s, stamp, repeats, refused)
                break
        else:
            raise InputError(
                f"camera: no image of frame {index}, shown {_REPEATS + 1} times (refused: {refused['early']} "
                f"too old, {refused['incomplete']} incomplete); is the camera running, is its rate right?"
            )


def _warm(camera: Camera, time: Time, clock: ClockMap, triggered: bool, on_image: OnImage | None) -> None:
    """Images for the map of the camera's clock: a map from a handful may be as late as the latest."""
    limit = time.now() + _WARM_S
    while clock.images < _WARM_IMAGES and time.now() < limit:
        if triggered:
            camera.trigger()
        image = camera.next(limit - time.now())
        if image is None or image.device_s is None:
            return
        stamp = clock.stamp(image)
        if on_image is not None:
            on_image(image, stamp.time_s)
