"""A rig's camera for `optolever live`: the mirror at rest, then frames of one fringe without end."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

import optolever as ol

from .rig_devices import Opened, devices_of, opened, wait_of

_RESTS = 8  # frames of the fringe
_PERIOD = 10.0  # of the fringe, pattern pixels


class _Triggered:
    """A camera that takes an image when it is asked for."""

    def __init__(self, now: Opened) -> None:
        self._camera = now.camera

    def next(self, timeout_s: float) -> "ol.projector.Image | None":
        self._camera.trigger()
        return self._camera.next(timeout_s)


@contextmanager
def rig_at_rest(
    rig: Path, cell: int, changes: Iterable[str]
) -> Iterator[tuple["ol.live.Prepared", "ol.live.Source"]]:
    """The rig with its mirror at rest, measured now by gray+phase and eight frames of the fringe, which then
    stays on the display; and its running camera. changes: of [devices]."""
    import numpy as np

    scene, devices = ol.scene.load(rig), devices_of(rig, changes)
    rows, cols = scene.pattern.rows, scene.pattern.cols
    dense, fringe = (
        ol.patterns.sequence("gray+phase", rows, cols),
        ol.patterns.sequence("crossed", rows, cols, period=_PERIOD),
    )
    count = len(dense)
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
            prepared = ol.live.prepare(
                scene, frames[count:], at_rest, fringe, cell=cell, bits=now.accepted.bits
            )
            yield prepared, _Triggered(now) if now.triggered else now.camera
        finally:
            now.camera.stop()
