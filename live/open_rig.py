"""A rig's camera as an iterator of readings; its rest as it was measured before, or measured now."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from optolever.camera import Devices, Opened, Timing, devices_of, opened, virtual_scene
from optolever.camera.cameras import Replay
from optolever.decode import decode
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.patterns import Sequence, sequence
from optolever.projector import Image
from optolever.scene import Scene, dent, load, strided, trace

from .follow import Followed, follow
from .fringe.rays_at_rest import rest_rays
from .probes import Probes
from .reading import Reading
from .rest.prepare import prepare, stated
from .rest.prepared import Prepared
from .source import PERIOD, Newest, Source, VirtualFinger
from .stream import Live

__all__ = ["Readings", "fringe_period", "kept_rest", "open_rig"]

_RESTS = 8  # frames of the fringe
_SPAN = 8.0  # camera pixels in a period of the fringe, at least
_PATIENCE_S = 5.0
_LOOK_S, _LOOKS = 2.0, 30  # and images, for a display that is slow to show the fringe
_RECENT = 60  # readings of the latency
_RATE = 30.0  # frames a second of a virtual camera


def kept_rest(rig: str | Path) -> Path:
    """Where a rig's newest rest is kept, beside its TOML."""
    return Path(rig).with_suffix(".live.npz")


def fringe_period(scene: Scene) -> float:
    """Of the fringe that `open` shows, pattern pixels: fine, but not too fine for the camera."""
    step = max(1, min(scene.camera.rows, scene.camera.cols) // 60)
    few = strided(scene, step)
    flat = trace(few, dent("flat", few))
    u, v = (np.where(flat.visible, one, np.nan) for one in (flat.u, flat.v))
    each = [np.hypot(np.diff(u, axis=axis), np.diff(v, axis=axis)) / step for axis in (0, 1)]
    return max(PERIOD, float(np.ceil(_SPAN * max(map(np.nanmedian, each)))))


class Readings:
    """Readings of a running camera, of its newest frame each, without end (a recording has one). prepared: of
    the rig; exposure_s: of a frame; notices: of the devices, and of a rest that no longer holds; probes;
    display: of the fringe."""

    def __init__(
        self, prepared: Prepared, now: Opened, notices: Iterable[Notice], finger: VirtualFinger | None
    ) -> None:
        self.prepared, self.exposure_s, self.notices = prepared, now.accepted.exposure_s, tuple(notices)
        self.source: Source = finger or now.arrivals()
        self.display = now.display
        self.probes = Probes(prepared, now.accepted.exposure_s)
        self._live, self._camera = Live(prepared), now.camera
        self._delays: list[float] = []
        self._newest = None if isinstance(now.camera, Replay) else Newest(self.source)

    def __iter__(self) -> Iterator[Reading]:
        return (followed.reading for followed in self.followed())

    def followed(self) -> Iterator[Followed]:
        """The readings with image, latency and probes."""
        with ExitStack() as stack:
            source = self.source if self._newest is None else stack.enter_context(self._newest)
            for followed in follow(self._live, source, None, self.probes):
                self._delays = [*self._delays[1 - _RECENT :], followed.delay]
                yield followed
                if isinstance(self._camera, Replay) and self._camera.over:
                    return

    @property
    def delay(self) -> float:
        """From the arrival of an image to its reading, s: the median of the last 60; NaN before the first."""
        return median(self._delays) if self._delays else float("nan")

    def __repr__(self) -> str:
        return f"Readings of {self.prepared!r}\n  latency {1e3 * self.delay:.3g} ms"


def open_rig(
    rig: str | Path, rest: Prepared | None = None, *, changes: Iterable[str] = (), anew: bool = False
) -> AbstractContextManager[Readings]:
    """Camera and display of a rig, and its readings: a context manager.

    rest: of the mirror; None: the newest that was measured, kept beside the TOML.
    It is used once a frame of two seconds is trusted. Where there is none, or it no longer holds (a notice
    says why), the mirror must be at rest: it is measured by gray+phase and eight frames of the fringe, and
    kept. On the mirror of a virtual camera a finger then presses and slides, unless the scene has a dent.
    changes: of [devices], KEY=VALUE; anew: measure it in any case. InputError of a rig that cannot be
    read, and of a rest that was given and does not hold."""
    rig, known, why = Path(rig), rest, ""
    scene, devices, name = load(rig), devices_of(rig, changes), "rest" if rest else str(kept_rest(rig))
    if known is None and Path(name).is_file():
        try:
            known = Prepared.load(name)
        except InputError as error:
            why = str(error)
    return _at_rest(rig, scene, devices, None if anew else known, name, why, rest is not None)


@contextmanager
def _at_rest(
    rig: Path, scene: Scene, devices: Devices, known: Prepared | None, name: str, why: str, given: bool
) -> Iterator[Readings]:
    """name, why: of a rest, and what is wrong with it; given: it must hold."""
    rows, cols = scene.pattern.rows, scene.pattern.cols
    if known is not None:
        fringe = sequence("crossed", rows, cols, period=known.rig.carriers.period)
        with opened(rig, devices, fringe) as now:
            now.require_size(scene)
            why = _other(known, scene)
            if not why:
                known = stated(known, scene)
                why = _look(known, now, now.wait(rig))
            if not why:
                yield Readings(known, now, map(_said, now.notices), _finger(rig, devices, fringe))
                return
        if given:
            raise InputError(f"{name}: no longer holds ({why}); measure the mirror at rest anew")
    dense = sequence("gray+phase", rows, cols)
    fringe = sequence("crossed", rows, cols, period=fringe_period(scene))
    shown = Sequence((*dense.frames, *fringe.frames), rows, cols)
    with opened(rig, devices, shown) as now:
        now.require_size(scene)
        prepared = _measured(now, scene, dense, fringe, now.wait(rig))
        prepared.save(kept_rest(rig))
        notices = [*map(_said, now.notices)]
        if why:
            cure = "it was measured anew, with everything still"
            notices.append(replace(_said(f"{name} no longer holds: {why}"), cure=cure))
        yield Readings(prepared, now, notices, _finger(rig, devices, fringe))


def _finger(rig: Path, devices: Devices, fringe: Sequence) -> VirtualFinger | None:
    """On the mirror of a virtual camera, whose scene has no dent of its own."""
    if devices.camera != "virtual" or (scene := virtual_scene(rig)).dent is not None:
        return None
    return VirtualFinger(scene, fringe, rate=devices.fps or _RATE)


def _said(text: str) -> Notice:
    return Notice(text, float("nan"), float("nan"), "")


def _other(known: Prepared, scene: Scene) -> str:
    """Why it is of another scene; empty: it is of this one."""
    size = scene.camera.rows, scene.camera.cols
    if (known.rows, known.cols) != size:
        return f"it is of {known.rows} x {known.cols} pixels, the rig's camera has {size[0]} x {size[1]}"
    carriers = known.rig.carriers
    planes = rest_rays(scene, *carriers.shape, carriers.cell, carriers.period).planes
    lit = known.rig.lit
    same = np.allclose(planes[:, lit], known.rig.mirror.planes[:, lit], rtol=1e-5, atol=1e-5)
    return "" if same else "the rig's geometry has changed since"


def _look(known: Prepared, now: Opened, timing: Timing | None) -> str:
    """Why no frame of two seconds and thirty images is trusted; empty: one is."""
    live, arrivals = Live(known), now.arrivals()
    image: Image | None = next(iter(now.acquire(timing, [0]))).image
    end, looks, why = now.time.now() + _LOOK_S, 0, ""
    while image is not None and (now.time.now() < end or looks < _LOOKS):
        looks += 1
        if image.complete:
            reading = live.update(image.pixels)
            if reading.trusted:
                return ""
            why = reading.reason
        image = arrivals.next(_PATIENCE_S)
    return why or "no image came"


def _measured(
    now: Opened, scene: Scene, dense: Sequence, fringe: Sequence, timing: Timing | None
) -> Prepared:
    """By all frames of dense, then some of the fringe, which stays on the display. The camera rests while
    they are prepared: else its images wait until then."""
    count = len(dense)
    taken = now.acquire(timing, (*range(count), *[count] * _RESTS))
    frames = np.stack([one.image.pixels for one in taken])
    now.camera.stop()
    prepared = prepare(scene, frames[count:], decode(frames[:count], dense), fringe, bits=now.accepted.bits)
    now.camera.start()
    return prepared
