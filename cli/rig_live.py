"""A rig's camera for `optolever live`: the mirror at rest, then frames of one fringe without end."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

import optolever as ol

from .rig_devices import devices_of, opened, wait_of

_RESTS = 8  # frames of the fringe
_PERIOD = 10.0  # of the fringe, pattern pixels


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
    with opened(rig, devices, shown) as now:
        now.require_size(scene)
        click.echo("The mirror at rest is measured: keep everything still.", err=True)
        taken = now.acquire(wait_of(now, rig), (*range(count), *[count] * _RESTS))
        frames = np.stack([one.image.pixels for one in taken])
        now.camera.stop()  # else the images of now wait until the rest is prepared
        at_rest = ol.decode.decode(frames[:count], dense)
        prepared = ol.live.prepare(scene, frames[count:], at_rest, fringe, bits=now.accepted.bits)
        now.camera.start()
        source = ol.projector.Arrivals(now.camera, now.time, now.clock, now.triggered, None, now.display)
        yield prepared, source, now.accepted.exposure_s
