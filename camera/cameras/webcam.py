"""What webcams have in common: no trigger, and controls that move by themselves, judged by the picture."""

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.projector import Camera, Wanted

__all__ = ["Untriggered", "locked", "require_free"]

_SETTLE_S = 0.5
_STILL = {"focus": 0.1, "exposure": 0.05}  # changes of sharpness and brightness, at most


class Untriggered:
    """A camera that runs by itself."""

    def trigger(self) -> float:
        """InputError: webcams have none."""
        raise InputError("camera: a webcam has no software trigger, trigger must be free")


def require_free(wanted: Wanted) -> None:
    """InputError where a trigger is asked for."""
    if wanted.trigger != "free":
        raise InputError(f"camera: trigger {wanted.trigger!r}, of a webcam it must be free")


def locked(camera: Camera, lock: Callable[[], list[str]]) -> tuple[str, ...]:
    """Lock everything while images come (many take a focus only then, and forget it when opened), and again
    half a second later; what moves nevertheless, by read-back and by the picture. lock: sets all controls,
    and returns the controls that did not hold.
    """
    camera.start()
    try:
        lock()
        before = latest(camera)
        unlocked = lock()
        after = latest(camera)
    finally:
        camera.stop()
    for what, size in _STILL.items():
        if before is None or after is None:
            break
        change = abs(_measure(after)[what] / max(_measure(before)[what], 1e-9) - 1)
        if change > size and not any(one.startswith(what) for one in unlocked):
            unlocked.append(f"{what}: the picture still changes, by {100 * change:.0f} %")
    return tuple(unlocked)


def latest(camera: Camera) -> NDArray[np.number] | None:
    """Pixels of the last complete image of half a second."""
    end, seen = time.monotonic() + _SETTLE_S, None
    while (left := end - time.monotonic()) > 0:
        image = camera.next(left)
        if image is None:
            time.sleep(min(left, 0.01))
        elif image.complete:
            seen = image.pixels
    return seen


def _measure(pixels: NDArray[np.number]) -> dict[str, float]:
    """Sharpness (mean step between columns over the mean) and brightness."""
    levels = pixels.astype(np.float64)
    mean = max(float(levels.mean()), 1e-9)
    return {"focus": float(np.abs(np.diff(levels, axis=1)).mean()) / mean, "exposure": mean}
