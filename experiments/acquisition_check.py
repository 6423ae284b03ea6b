"""Check that each image shows its pattern: a display's light changes later than its buffer is swapped."""

import numpy as np

from optolever.decode import Correspondence
from optolever.projector import Capture

__all__ = ["frames_of_another"]

_PIXELS = 20_000


def frames_of_another(capture: Capture, found: Correspondence) -> list[int]:
    """Indices of frames that the preceding pattern fits better than their nominal one.

    Model: the light of a pixel is an offset and a gain times the pattern's level at its decoded coordinates
    (least squares).
    """
    sequence = capture.sequence
    good = found.good.ravel()
    places = np.flatnonzero(good)[:: max(1, int(good.sum()) // _PIXELS)]
    if len(places) == 0:
        return []
    u = np.clip(np.rint(found.u.ravel()[places]), 0, sequence.cols - 1).astype(int)
    v = np.clip(np.rint(found.v.ravel()[places]), 0, sequence.rows - 1).astype(int)
    levels = np.array([sequence.render_frame(k)[v, u] for k in range(len(sequence))], np.float64)
    light = capture.frames.reshape(len(sequence), -1)[:, places].astype(np.float64)
    level = levels - levels.mean(axis=0)
    gain = (level * light).sum(axis=0) / np.maximum((level**2).sum(axis=0), 1e-9)
    model = light.mean(axis=0) + gain * level
    by_own = ((light[1:] - model[1:]) ** 2).sum(axis=1)
    by_last = ((light[1:] - model[:-1]) ** 2).sum(axis=1)
    return [int(k) + 1 for k in np.flatnonzero(by_last < by_own)]
