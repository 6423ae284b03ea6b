"""Addresses of cameras: BACKEND:NAME, or serial:NUMBER. Names are resolved when a camera is opened."""

import importlib
from collections.abc import Callable
from pathlib import Path

from optolever.errors import InputError
from optolever.projector import Camera, Identity

__all__ = ["find_cameras", "open_camera"]

#: Prefix of an address -> file here, with `find() -> list[Identity]` and `open_named(name) -> Camera`.
_BACKENDS = {"v4l2": "v4l2", "gige": "aravis", "aravis": "aravis", "pylon": "pylon", "opencv": "opencv"}
_KINDS = (
    "serial:NUMBER, v4l2:PATH, gige:ADDRESS, aravis:NAME, pylon:SERIAL, opencv:URL, folder:DIR, replay:DIR"
)


def find_cameras() -> tuple[list[Identity], dict[str, str]]:
    """Cameras by every back-end, and by back-end the reason why it cannot look."""
    found: list[Identity] = []
    silent: dict[str, str] = {}
    for backend in dict.fromkeys(_BACKENDS.values()):
        try:
            module = importlib.import_module(f"{__package__}.{backend}")
            found += module.find()
        except (InputError, OSError) as error:
            silent[backend] = str(error)
    return found, silent


def open_camera(address: str) -> Camera:
    """The camera of an address. InputError if it is unknown, busy, not permitted or ambiguous."""
    kind, _, name = address.partition(":")
    if kind == "serial" and name:
        return open_camera(_by_serial(name))
    if kind == "folder" and name:
        from optolever.projector import Capture

        from .stand_ins import StillCamera

        return StillCamera(Capture.load(name), Identity("folder", name, "", address))
    if kind == "replay" and name:
        from .stand_ins import Replay

        return Replay(Path(name))
    if kind not in _BACKENDS or not name:
        raise InputError(f"camera: {address!r}, must be {_KINDS}, or virtual (optolever doctor)")
    if name.isdigit() and kind in ("v4l2", "opencv"):
        raise InputError(
            f"camera: {address!r} is a number, which changes when something is plugged in; give the path, "
            "such as v4l2:/dev/v4l/by-id/... (optolever doctor)"
        )
    opener: Callable[[str], Camera] = importlib.import_module(f"{__package__}.{_BACKENDS[kind]}").open_named
    return opener(name)


def _by_serial(serial: str) -> str:
    found, silent = find_cameras()
    fitting = [one for one in found if one.serial == serial]
    if fitting and len({one.backend for one in fitting}) == len(fitting):
        return fitting[0].address  # several back-ends know the one camera
    if fitting:
        addresses = ", ".join(one.address for one in fitting)
        raise InputError(f"camera: {len(fitting)} have the serial {serial!r}; name one: {addresses}")
    known = ", ".join(one.serial for one in found if one.serial) or "none"
    missing = f" (not looked for: {', '.join(silent)})" if silent else ""
    raise InputError(f"camera: serial {serial!r} is not connected, there is {known}{missing}")
