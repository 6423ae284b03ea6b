"""A rig's devices: `[devices]` and `[sync]` of its TOML, changes of them as KEY=VALUE, and both opened."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.projector import (
    Accepted,
    Camera,
    Display,
    Identity,
    PatternWindow,
    RealTime,
    Time,
    Wanted,
    capture,
    capture_colour,
    choose_monitor,
    monitors,
)
from optolever.scene import MOSAICS, Scene, dent_from_text, load, rig_table
from optolever.schema import from_table

from .acquisition import Arrivals, ClockMap, Taken, Timing, acquire
from .cameras import Replay, StillCamera, open_camera

__all__ = ["VIRTUAL", "Devices", "Opened", "devices_of", "opened", "timing_of", "virtual_scene"]

#: Suffix of the rig before a virtual camera.
VIRTUAL = ".virtual.toml"


@dataclass(frozen=True)
class Devices:
    """[devices]: addresses, and the settings of the camera; rows, cols: 0 is the full sensor."""

    camera: str = ""
    display: str = ""
    exposure_ms: float = 16.6667
    gain: float | None = None
    bits: int = 8
    rows: int = 0
    cols: int = 0
    row: int = 0
    col: int = 0
    fps: float | None = None
    trigger: Literal["free", "software", "hardware"] = "free"
    focus: int | None = None
    format: str = ""

    def wanted(self) -> Wanted:
        """Settings for a camera."""
        settings = {k: v for k, v in asdict(self).items() if k not in ("camera", "display", "exposure_ms")}
        return Wanted(1e-3 * self.exposure_ms, **settings)

    def table(self) -> dict[str, Any]:
        """The known fields, for TOML."""
        known = asdict(self) | {"format": self.format or None}
        return {name: value for name, value in known.items() if value is not None}


@dataclass(frozen=True)
class Opened:
    """An opened rig. still: a simulated or replayed one, without delays; notices: settings that did not hold,
    faults of the display."""

    camera: Camera
    display: Display
    accepted: Accepted
    time: Time
    clock: ClockMap
    still: bool
    notices: tuple[str, ...] = ()

    @property
    def triggered(self) -> bool:
        """Whether the camera waits for the program."""
        return self.accepted.trigger == "software"

    def require_size(self, scene: Scene) -> None:
        """InputError unless the images are as large as those of the scene's camera."""
        side = 2 if self.accepted.mosaic in MOSAICS else 1
        size = self.accepted.rows // side, self.accepted.cols // side
        known = scene.camera.rows, scene.camera.cols
        if size != known:
            what = "quads of 2 x 2 pixels" if side > 1 else "pixels"
            raise InputError(
                f"camera: images of {size[1]}x{size[0]} {what}, the rig's [camera] has "
                f"{known[1]}x{known[0]}; correct it, or --set rows=ROWS --set cols=COLS"
            )

    def wait(self, rig: Path) -> Timing | None:
        """Timing of a capture: [sync] of the rig or of the recording, no delays for a simulated camera
        or a recording without swaps. None: unknown. InputError if it was measured with other settings."""
        if self.still or (isinstance(self.camera, Replay) and not self.camera.swaps):
            return Timing(0, 0, 0, 0, 0, 0, 0.01, self.accepted.exposure_s)
        timing = timing_of(rig)
        if timing is None and isinstance(self.camera, Replay) and "timing" in self.camera.recording.about:
            recording = self.camera.recording
            timing = Timing.from_table(recording.about["timing"], str(recording.folder))
        if timing is not None:
            timing.require(self.accepted)
        return timing

    def arrivals(self) -> Arrivals:
        """The images as they come."""
        return Arrivals(self.camera, self.time, self.clock, self.triggered, None, self.display)

    def acquire(self, timing: Timing | None, order: Iterable[int], **calls: Any) -> Iterator[Taken]:
        """`camera.acquire` of the frames of `order`."""
        return acquire(
            self.display, self.camera, timing, order,
            time=self.time, clock=self.clock, triggered=self.triggered, **calls,
        )  # fmt: skip


def devices_of(rig: Path, changes: Iterable[str] = ()) -> Devices:
    """[devices] of a rig, changed by KEY=VALUE. InputError names the field."""
    where = f"{rig}: [devices]"
    devices = from_table(Devices, _table(rig).get("devices", {}) | dict(map(_change, changes)), where)
    for name, value in (("exposure_ms", devices.exposure_ms), ("fps", devices.fps)):
        if value is not None and not value > 0:
            raise InputError(f"{where}: {name} is {value!r}, must be above 0")
    if not devices.camera:
        cure = "give --set camera=ADDRESS (optolever doctor)"
        raise InputError(f"{where}: camera is missing; {cure}")
    return devices


def _change(text: str) -> tuple[str, Any]:
    """Name and value of KEY=VALUE: a number where the field has one."""
    name, equals, value = text.partition("=")
    if not equals:
        raise InputError(f"--set {text}: must be KEY=VALUE, such as camera=virtual")
    for kind in () if name in ("camera", "display", "trigger") else (int, float):
        with suppress(ValueError):
            return name, kind(value)
    return name, value


def timing_of(rig: Path) -> Timing | None:
    """[sync] of a rig; None without."""
    section = _table(rig).get("sync")
    return None if section is None else Timing.from_table(section, f"{rig}: [sync]")


def _table(rig: Path) -> dict[str, Any]:
    table = rig_table(rig)
    if not isinstance(table.get("devices", {}), dict) or not isinstance(table.get("sync", {}), dict):
        raise InputError(f"{rig}: devices and sync must be tables")
    return table


@contextmanager
def opened(rig: Path, devices: Devices, shown: Sequence, *, running: bool = True) -> Iterator[Opened]:
    """Camera and display of a rig, set (and running); the display holds the frames of `shown`."""
    with ExitStack() as stack:
        camera = _camera(rig, devices, shown)
        stack.callback(camera.close)
        accepted = camera.configure(replace(devices.wanted(), colour=shown.packing is not None))
        _require_colours(accepted, camera, shown)
        still = isinstance(camera, Display)  # a recording is one, and has its own time
        display: Any
        display, faults = (camera, ()) if still else _window(devices, shown, stack)
        time = camera if isinstance(camera, Time) else RealTime()
        if running:
            camera.start()
            stack.callback(camera.stop)
        still = still and isinstance(time, RealTime)
        yield Opened(camera, display, accepted, time, ClockMap(), still, (*accepted.unlocked, *faults))


def _require_colours(accepted: Accepted, camera: Camera, shown: Sequence) -> None:
    """InputError where a sequence in colour needs other pictures."""
    if shown.packing is None:
        return
    kinds = {frame.kind for frame in shown.frames}
    wrong = ""
    if not accepted.mosaic:
        wrong = "takes grey pictures"
    elif accepted.mosaic == "YUYV" and "phase" in kinds and all(f.bit is None for f in shown.frames):
        wrong = "gives YUYV, whose colours are means of neighbours, which periods without bits do not bear"
    if wrong:
        raise InputError(f"camera: {camera.identity.address} {wrong}; raw, or grey patterns")


def virtual_scene(rig: Path) -> Scene:
    """The rig before a virtual camera: RIG.virtual.toml beside rig.toml, which no fit changes, with the dent
    of rig.toml; else rig.toml."""
    scene, own = load(rig), rig.with_suffix(VIRTUAL)
    return replace(load(own), dent=scene.dent) if own.exists() else scene


def _camera(rig: Path, devices: Devices, shown: Sequence) -> Camera:
    if devices.camera != "virtual":
        return open_camera(devices.camera)
    scene = virtual_scene(rig)
    take = capture if shown.packing is None else capture_colour
    seen = take(scene, dent_from_text(scene.dent or "flat", scene), shown)
    return StillCamera(seen, Identity("virtual", "virtual sensor", "", "virtual"))


def _window(devices: Devices, shown: Sequence, stack: ExitStack) -> tuple[Any, tuple[str, ...]]:
    """A PatternWindow on the monitor of that name, or a plain one; faults of the monitor."""
    if not devices.display:
        cure = "--set display=NAME (optolever doctor lists them), or window"
        raise InputError(f"display: must be given, {cure}")
    if devices.display == "window":
        return stack.enter_context(PatternWindow(shown)), ()
    monitor = choose_monitor(monitors(), devices.display)
    return stack.enter_context(PatternWindow(shown, monitor=monitor.index)), monitor.faults()
