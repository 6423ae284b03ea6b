"""A rig's camera for `optolever live`: the mirror at rest, then frames of one fringe without end."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

import optolever as ol
from optolever import InputError

from .rig_devices import Opened, devices_of, opened, wait_of

_RESTS = 8  # frames of the fringe
_PERIOD = 10.0  # of the fringe, pattern pixels


class _Watched:
    """A rig's camera, asked for every image where it is triggered. InputError once the display is gone."""

    def __init__(self, now: Opened) -> None:
        self._now = now

    def next(self, timeout_s: float) -> "ol.projector.Image | None":
        display = self._now.display
        if isinstance(display, ol.projector.PatternWindow) and not display.alive:
            raise InputError("the display is gone: its window was closed, or its process ended")
        if self._now.triggered:
            self._now.camera.trigger()
        return self._now.camera.next(timeout_s)

    def flush(self) -> None:
        """Pass over the images that were taken until now: they waited while the rest was prepared."""
        now = self._now.time.now()
        while not self._now.triggered and (image := self.next(1.0)) is not None:
            if image.arrived_s >= now:
                return


@contextmanager
def rig_at_rest(
    rig: Path, changes: Iterable[str]
) -> Iterator[tuple["ol.live.Prepared", "ol.live.Source", float]]:
    """The rig with its mirror at rest, measured now by gray+phase and eight frames of the fringe, which then
    stays on the display; its running camera; and its exposure, s. changes: of [devices]."""
    import numpy as np

    scene, devices = ol.scene.load(rig), devices_of(rig, changes)
    rows, cols = scene.pattern.rows, scene.pattern.cols
    dense = ol.patterns.sequence("gray+phase", rows, cols)
    fringe, count = ol.patterns.sequence("crossed", rows, cols, period=_PERIOD), len(dense)
    shown = ol.patterns.Sequence((*dense.frames, *fringe.frames), rows, cols)
    with opened(rig, devices, shown, running=False) as now:
        now.require_size(scene)
        timing = wait_of(now, rig)
        now.camera.start()
        try:
            click.echo("The mirror at rest is measured: keep everything still.", err=True)
            taken = now.acquire(timing, (*range(count), *[count] * _RESTS))
            frames = np.stack([one.image.pixels for one in taken])
            at_rest = ol.decode.decode(frames[:count], dense)
            prepared = ol.live.prepare(scene, frames[count:], at_rest, fringe, bits=now.accepted.bits)
            source = _Watched(now)
            source.flush()
            yield prepared, source, now.accepted.exposure_s
        finally:
            now.camera.stop()
