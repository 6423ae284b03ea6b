"""The devices of a rig: `[devices]` and `[sync]` of its TOML, changes of them by --set, and both opened."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import optolever as ol
from optolever import InputError

from .arguments import Opt
from .options import RigFile
from .show import print_notices

_KINDS: Mapping[Any, tuple[Any, str]] = {str: (str, "text"), int: (int, "whole number")}
_NUMBER: tuple[Any, str] = (int | float, "number")
_TRIGGERS = ("free", "software", "hardware")


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
    trigger: str = "free"
    focus: int | None = None

    def wanted(self) -> "ol.projector.Wanted":
        """Settings for a camera."""
        settings = {k: v for k, v in asdict(self).items() if k not in ("camera", "display", "exposure_ms")}
        return ol.projector.Wanted(1e-3 * self.exposure_ms, **settings)

    def table(self) -> dict[str, Any]:
        """The known fields, for TOML."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class Opened:
    """An opened rig. still: a simulated or replayed one, without delays."""

    camera: "ol.projector.Camera"
    display: "ol.projector.Display"
    accepted: "ol.projector.Accepted"
    time: "ol.projector.Time"
    clock: "ol.projector.ClockMap"
    still: bool

    @property
    def triggered(self) -> bool:
        """Whether the camera waits for the program."""
        return self.accepted.trigger == "software"

    def require_size(self, scene: "ol.scene.Scene") -> None:
        """InputError unless the images are as large as those of the scene's camera."""
        size, known = (self.accepted.rows, self.accepted.cols), (scene.camera.rows, scene.camera.cols)
        if size != known:
            raise InputError(
                f"camera: images of {size[1]}x{size[0]} pixels, the rig's [camera] has "
                f"{known[1]}x{known[0]}; correct it, or --set rows=ROWS --set cols=COLS"
            )

    def acquire(
        self, timing: "ol.projector.Timing | None", order: Iterable[int], **calls: Any
    ) -> "Iterator[ol.projector.Taken]":
        """`projector.acquire` of the frames of `order`."""
        return ol.projector.acquire(
            self.display, self.camera, timing, order,
            time=self.time, clock=self.clock, triggered=self.triggered, **calls,
        )  # fmt: skip


OpenedRig = Annotated[Path, Opt("--rig RIG.toml", "The rig: its scene, [devices] and [sync].", RigFile())]
Changes = Annotated[
    tuple[str, ...],
    Opt(
        "--set KEY=VALUE",
        "Change [devices] for this run, such as camera=virtual or exposure_ms=10; repeatable.",
    ),
]


def devices_of(rig: Path, changes: Iterable[str] = ()) -> Devices:
    """[devices] of a rig, changed by KEY=VALUE. InputError names the field."""
    where = f"{rig}: [devices]:"
    table = _table(rig).get("devices", {}) | dict(map(_change, changes))
    known = {field.name: field.type for field in fields(Devices)}
    for name, value in table.items():
        if name not in known:
            raise InputError(f"{where} unknown field {name!r}, known are {', '.join(known)}")
        kind, word = _KINDS.get(known[name], _NUMBER)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise InputError(f"{where} {name} is {value!r}, must be a {word}")
        if name in ("exposure_ms", "fps") and not value > 0:
            raise InputError(f"{where} {name} is {value!r}, must be above 0")
    devices = Devices(**table)
    if devices.trigger not in _TRIGGERS:
        raise InputError(f"{where} trigger is {devices.trigger!r}, must be one of {', '.join(_TRIGGERS)}")
    if not devices.camera:
        cure = "give --set camera=ADDRESS (optolever camera devices)"
        raise InputError(f"{where} camera is missing; {cure}")
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


def sequence_of(rig: Path, text: str) -> "ol.patterns.Sequence":
    """The sequence of that name on a rig's display."""
    pattern = ol.scene.load(rig).pattern
    return ol.patterns.sequence_from_text(text, pattern.rows, pattern.cols)


def levels_of(rig: Path, *kinds: str) -> "ol.patterns.Sequence":
    """A full display per kind (black, white)."""
    pattern = ol.scene.load(rig).pattern
    return ol.patterns.Sequence(tuple(map(ol.patterns.Frame, kinds)), pattern.rows, pattern.cols)


def timing_of(rig: Path) -> "ol.projector.Timing | None":
    """[sync] of a rig; None without."""
    section = _table(rig).get("sync")
    return None if section is None else ol.projector.Timing.from_table(section, f"{rig}: [sync]")


def wait_of(now: Opened, rig: Path) -> "ol.projector.Timing | None":
    """Timing of a capture: [sync] of the rig or of the recording, no delays for a simulated or replayed
    camera. None: unknown, with a notice. InputError if it was measured with other settings.
    """
    from optolever.projector.cameras import Replay

    if now.still:
        return ol.projector.Timing(0, 0, 0, 0, 0, 0, 0.01, now.accepted.exposure_s)
    timing = timing_of(rig)
    if timing is None and isinstance(now.camera, Replay) and "timing" in now.camera.recording.about:
        recording = now.camera.recording
        timing = ol.projector.Timing.from_table(recording.about["timing"], str(recording.folder))
    if timing is None:
        wait = "every pattern gets 0.5 s to settle; optolever camera sync measures the time"
        print_notices([f"The rig has no [sync]: {wait}"])
        return None
    timing.require(now.accepted)
    return timing


def _table(rig: Path) -> dict[str, Any]:
    table = ol.scene.rig_table(rig)
    if not isinstance(table.get("devices", {}), dict) or not isinstance(table.get("sync", {}), dict):
        raise InputError(f"{rig}: devices and sync must be tables")
    return table


@contextmanager
def opened(
    rig: Path, devices: Devices, shown: "ol.patterns.Sequence", *, running: bool = True
) -> Iterator[Opened]:
    """Camera and display of a rig, set (and running); the display holds the frames of `shown`."""
    with ExitStack() as stack:
        camera = _camera(rig, devices, shown)
        stack.callback(camera.close)
        accepted = camera.configure(devices.wanted())
        print_notices(accepted.unlocked)
        still = isinstance(camera, ol.projector.Display)  # a recording is one, and has its own time
        display: Any = camera if still else stack.enter_context(_window(devices, shown))
        time = camera if isinstance(camera, ol.projector.Time) else ol.projector.RealTime()
        if running:
            camera.start()
            stack.callback(camera.stop)
        still = still and isinstance(time, ol.projector.RealTime)
        yield Opened(camera, display, accepted, time, ol.projector.ClockMap(), still)


def _camera(rig: Path, devices: Devices, shown: "ol.patterns.Sequence") -> "ol.projector.Camera":
    from optolever.projector.cameras import StillCamera, open_camera

    if devices.camera != "virtual":
        return open_camera(devices.camera)
    scene = ol.scene.load(rig)
    seen = ol.projector.capture(scene, ol.scene.dent_from_text(scene.dent or "flat", scene), shown)
    return StillCamera(seen, ol.projector.Identity("virtual", "virtual sensor", "", "virtual"))


def _window(devices: Devices, shown: "ol.patterns.Sequence") -> Any:
    """A PatternWindow on the monitor of that name, or a plain one; notices name faults of the monitor."""
    if not devices.display:
        cure = "--set display=NAME (optolever camera devices lists them), or window"
        raise InputError(f"display: must be given, {cure}")
    if devices.display == "window":
        return ol.projector.PatternWindow(shown)
    monitor = ol.projector.choose_monitor(ol.projector.monitors(), devices.display)
    print_notices(monitor.faults())
    return ol.projector.PatternWindow(shown, monitor=monitor.index)
