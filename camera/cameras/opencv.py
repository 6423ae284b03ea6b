"""Streams of network cameras, and films, by OpenCV: no serial, no counter, no setting that can be changed."""

import time
from pathlib import Path

import cv2

from optolever.errors import InputError
from optolever.projector import Accepted, CameraLost, Identity, Image, Wanted

from .pixel_formats import no_format
from .webcam import Untriggered, require_free

__all__ = ["OpenCVCamera", "find", "open_named"]

_GONE_S = 5.0
_AS_IT_COMES = ("exposure, gain, focus: a stream has no controls; set them in the camera",)


def find() -> list[Identity]:
    """Nothing: streams do not say that they are there."""
    return []


class OpenCVCamera(Untriggered):
    """Read in `next`; stamps by the stream's where they rise. OpenCV hides the counter."""

    lost = 0

    def __init__(self, name: str) -> None:
        """By URL, or path of a film."""
        if "://" not in name and Path(name).is_char_device():
            raise InputError(
                f"camera: opencv:{name} is a device, whose settings OpenCV hides; take v4l2:{name}"
            )
        if "://" not in name and not Path(name).exists():
            raise InputError(f"camera: {name}: no such path; optolever doctor lists cameras")
        self._capture = cv2.VideoCapture(name)
        if not self._capture.isOpened():
            raise InputError(f"camera: {name}: cannot be opened; busy, no permission, or no video")
        self._name, self._last, self._stamp = name, time.monotonic(), 0.0
        self.identity = Identity("opencv", self._capture.getBackendName(), "", f"opencv:{name}")

    def configure(self, wanted: Wanted) -> Accepted:
        """Nothing is set: size and rate are the stream's, the exposure is taken as it is said to be."""
        require_free(wanted)
        if wanted.colour:
            raise no_format(self._name, True, wanted.bits)
        rows, cols, fps = (
            self._capture.get(each)
            for each in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FPS)
        )
        return Accepted(wanted.exposure_s, int(rows), int(cols), fps=fps or None, unlocked=_AS_IT_COMES)

    def start(self) -> None:
        """Runs from its opening on."""
        self._last = time.monotonic()

    def next(self, timeout_s: float) -> Image | None:
        """Blocks until the stream hands out an image; CameraLost after 5 s of refusals."""
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
        """Give the stream back."""
        self._capture.release()


open_named = OpenCVCamera
