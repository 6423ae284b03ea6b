"""Whatever OpenCV opens by a path or URL: no serial, no counter, no exposure that can be trusted."""

import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from optolever.errors import InputError

from ..devices import Accepted, CameraLost, Identity, Image, Wanted
from .webcam import Untriggered, locked, require_free

__all__ = ["OpenCVCamera", "find", "open_named"]

_MANUAL = (1.0, 0.25)  # of CAP_PROP_AUTO_EXPOSURE: V4L2's number, and older OpenCV's
_GONE_S = 5.0
_BUFFERS = 4  # images that wait in a driver
#: Properties that move or distort: number, name, value.
_LOCKS = (
    (cv2.CAP_PROP_AUTOFOCUS, "focus", 0),
    (cv2.CAP_PROP_SHARPNESS, "sharpness", 0),
    (cv2.CAP_PROP_GAMMA, "gamma", 100),
    (cv2.CAP_PROP_BACKLIGHT, "backlight compensation", 0),
    (cv2.CAP_PROP_AUTO_WB, "white balance", 0),
)
_EXPOSURE_UNIT_S = 1e-4  # V4L2; elsewhere powers of two


def find() -> list[Identity]:
    """Nothing: OpenCV knows indices only, which change when something is plugged in."""
    return []


def open_named(name: str) -> "OpenCVCamera":
    """By path (/dev/v4l/by-id/...) or URL."""
    return OpenCVCamera(name)


class OpenCVCamera(Untriggered):
    """Read in `next`; stamps by the driver's where they rise. OpenCV hides the counter."""

    lost = 0

    def __init__(self, name: str) -> None:
        if "://" not in name and not Path(name).exists():
            raise InputError(f"camera: {name}: no such path; optolever camera devices lists cameras")
        self._capture = cv2.VideoCapture(str(Path(name).resolve()) if "://" not in name else name)
        if not self._capture.isOpened():
            raise InputError(f"camera: {name}: cannot be opened; busy, no permission, or no video")
        self._live = "://" not in name and Path(name).resolve().is_char_device()  # else a film or a stream
        self._name, self._last, self._stamp = name, time.monotonic(), 0.0
        self._wanted = Wanted(0.0)

    @property
    def identity(self) -> Identity:
        """Its path."""
        return Identity("opencv", self._capture.getBackendName(), "", f"opencv:{self._name}")

    def configure(self, wanted: Wanted) -> Accepted:
        """Set and read back; settings that did not hold are listed as unlocked."""
        require_free(wanted)
        get = self._capture.get
        if wanted.rows and wanted.cols:
            self._set(cv2.CAP_PROP_FRAME_HEIGHT, wanted.rows)
            self._set(cv2.CAP_PROP_FRAME_WIDTH, wanted.cols)
        if wanted.fps is not None:
            self._set(cv2.CAP_PROP_FPS, wanted.fps)
        focus = wanted.focus if wanted.focus is not None else round(get(cv2.CAP_PROP_FOCUS))
        self._wanted = replace(wanted, focus=focus)
        unlocked = locked(self, self._lock) if self._live else tuple(self._lock())
        exposure = float(get(cv2.CAP_PROP_EXPOSURE))
        accepted = exposure * _EXPOSURE_UNIT_S if sys.platform == "linux" else 2.0**exposure
        rows, cols = (int(get(p)) for p in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH))
        return Accepted(
            accepted if 0.5 < accepted / wanted.exposure_s < 2 else wanted.exposure_s,
            rows,
            cols,
            gain=None if wanted.gain is None else float(get(cv2.CAP_PROP_GAIN)),
            fps=float(get(cv2.CAP_PROP_FPS)) or None,
            unlocked=unlocked,
            focus=focus if focus > 0 else None,
        )

    def _lock(self) -> list[str]:
        wanted, unlocked = self._wanted, []
        if not any(self._set(cv2.CAP_PROP_AUTO_EXPOSURE, value) == value for value in _MANUAL):
            unlocked.append("exposure: automatic exposure cannot be switched off")
        seconds = wanted.exposure_s
        units = seconds / _EXPOSURE_UNIT_S if sys.platform == "linux" else float(np.log2(seconds))
        exposure = self._set(cv2.CAP_PROP_EXPOSURE, units)
        accepted = exposure * _EXPOSURE_UNIT_S if sys.platform == "linux" else 2.0**exposure
        if not 0.5 < accepted / seconds < 2:
            unlocked.append(f"exposure: the driver answers {exposure:g} to {units:g}")
        if wanted.gain is not None:
            self._set(cv2.CAP_PROP_GAIN, wanted.gain)
        for prop, what, value in (*_LOCKS, (cv2.CAP_PROP_FOCUS, "focus", wanted.focus or 0)):
            if self._capture.get(prop) in (-1, 0):  # there is none, or it is off
                continue
            held = self._set(prop, value)
            if held != value:
                unlocked.append(f"{what}: the driver answers {held:g} to {value}")
        return unlocked

    def _set(self, what: int, value: float) -> float:
        self._capture.set(what, value)
        return float(self._capture.get(what))

    def start(self) -> None:
        """Runs from its opening on; what waits is passed over."""
        if self._live:
            for _ in range(_BUFFERS):
                self._capture.grab()
        self._last = time.monotonic()

    def next(self, timeout_s: float) -> Image | None:
        """Blocks until the driver hands out an image; CameraLost after 5 s of refusals."""
        del timeout_s
        done, frame = self._capture.read()
        now = time.monotonic()
        if not done:
            if now - self._last > _GONE_S:
                raise CameraLost(
                    f"camera: {self._name} gave no image for {_GONE_S:g} s: unplugged, or without power"
                )
            time.sleep(0.01)
            return None
        stamp = 1e-3 * float(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        rises, self._stamp, self._last = stamp > self._stamp, stamp, now
        grey = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        return Image(grey, None, stamp if rises else None, now)

    def stop(self) -> None:
        """Runs until it is closed."""

    def close(self) -> None:
        """Give the camera back."""
        self._capture.release()
