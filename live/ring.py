"""Ring: a code of several frames, one height per frame: each new frame replaces the oldest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optolever.decode import Correspondence, Decoder
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.patterns import Sequence
from optolever.reconstruct import HeightMap, HeightStream
from optolever.scene import Scene

__all__ = ["Ring"]

#: Difference from the frame of the preceding cycle, in sigma of noise, and share of pixels beyond it.
_SIGMAS, _SHARE = 5.0, 1e-3
_CURE = "hold still for two rounds of frames, or show one crossed fringe (optolever live)"


class Ring:
    """Heights of a code of N frames, displayed in cycles.

    A height is that of the last N frames. While the mirror moves, these record different shapes: most
    inconsistent pixels are flagged, others may be wrong. A notice warns as long as one of the N frames
    differs from the frame that it replaced. The profile is the decoder's, or of the first N frames.
    """

    def __init__(self, scene: Scene, sequence: Sequence, decoder: Decoder | None = None) -> None:
        """decoder: with the rig's profile; default: one that estimates it from the first N frames."""
        self._decoder = decoder or Decoder(sequence)
        self._sequence, self._profile = sequence, self._decoder.profile
        self._stream = HeightStream(scene)
        self._frames: NDArray[np.generic] | None = None
        self._seen = np.zeros(len(sequence), np.bool_)
        self._changed = np.zeros(len(sequence), np.bool_)
        self._number = -1
        #: Of the last N frames; None until each frame of the sequence has arrived.
        self.correspondence: Correspondence | None = None

    def update(self, frame: ArrayLike, number: int | None = None) -> HeightMap | None:
        """The height (H, W) of the last N frames; None until each frame of the sequence has arrived.

        frame (H, W); number: index of the frame in the sequence, default: the one after the last. InputError
        if shape or type differ from the last frame's, or for an index outside the sequence.
        """
        image, count = np.asarray(frame), len(self._seen)
        number = (self._number + 1) % count if number is None else number
        if not 0 <= number < count:
            raise InputError(f"ring: number is {number}, must be 0 to {count - 1}")
        if self._frames is None:
            self._frames = np.zeros((count, *image.shape), image.dtype)
        if (image.shape, image.dtype) != (self._frames.shape[1:], self._frames.dtype):
            kind = f"{self._frames.dtype} {self._frames.shape[1:]}"
            raise InputError(f"ring: frame is {image.dtype} {image.shape}, must be {kind} as the last")
        if self._seen[number]:
            self._changed[number] = self._differ(self._frames[number], image)
        self._frames[number], self._seen[number], self._number = image, True, number
        if not self._seen.all():
            return None
        self.correspondence = self._decoder.decode(self._frames)
        self._profile = self._profile or self._decoder.profile
        if self._decoder.profile is not self._profile:  # estimated anew while the mirror moved
            self._decoder = Decoder(self._sequence, self._profile)
        height = self._stream.update(self.correspondence)
        share = float(self._changed.mean())
        moving = (
            Notice(
                "The mirror moved during the last round of frames; share of changed frames", share, 0.0, _CURE
            ),
        )
        return replace(height, notices=(*height.notices, *moving)) if share else height

    def _differ(self, last: NDArray[np.generic], new: NDArray[np.generic]) -> bool:
        """Whether two frames (H, W) of one index differ by more than noise; True if the noise is unknown."""
        if self._profile is None:
            return True
        two = np.stack([last, new]).astype(np.float32)
        variance = 2 * self._profile.exposures[0].noise.variance(two.mean(axis=0))
        return bool(np.mean(np.square(two[1] - two[0]) > _SIGMAS**2 * variance) > _SHARE)
