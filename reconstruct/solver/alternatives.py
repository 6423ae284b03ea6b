"""The edge problem by a sparse factorisation, for extreme weights of `integrate`."""

import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg

from ..arrays import Floats, Mask
from .edges import divergence
from .poisson import Accuracy, MaskedEdges, PoissonResult

__all__ = ["DirectEdges"]


class DirectEdges(MaskedEdges):
    """Any mask, any weights: normal equations by a sparse factorisation, the first pixel of every component
    pinned. What extreme weights ask for.
    """

    def __init__(self, wx: Floats, wy: Floats, mask: Mask, separable: bool = True) -> None:
        super().__init__(wx, wy, mask)
        used = mask.ravel().copy()
        used[np.unique(scipy.ndimage.label(mask)[0].ravel(), return_index=True)[1]] = False
        self._free = np.flatnonzero(used)
        self._factor = None
        if self._free.size:
            self._factor = scipy.sparse.linalg.splu(
                self._normal(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )

    def _normal(self) -> scipy.sparse.csc_array:
        """D^T w D of the free pixels, in their order."""
        wx, wy = self.weights
        place = np.full(wx.shape, -1)
        place.reshape(-1)[self._free] = np.arange(self._free.size)
        tail = np.concatenate([place[:, :-1].ravel(), place[:-1].ravel()])
        head = np.concatenate([place[:, 1:].ravel(), place[1:].ravel()])
        weight = np.concatenate([wx[:, :-1].ravel(), wy[:-1].ravel()])
        inner = (tail >= 0) & (head >= 0) & (weight > 0)
        count = self._free.size
        sums = sum(np.bincount(end + 1, weight, count + 1)[1:] for end in (tail, head))
        tail, head, weight, every = tail[inner], head[inner], weight[inner], np.arange(count)
        rows, cols = np.concatenate([tail, head, every]), np.concatenate([head, tail, every])
        return scipy.sparse.csc_array(
            (np.concatenate([-weight, -weight, sums]), (rows, cols)), shape=(count, count)
        )

    def solve(
        self, gx: Floats, gy: Floats, accuracy: Accuracy, start: Floats | None = None, limit: int = 500
    ) -> PoissonResult:
        """One direct solve."""
        x = np.zeros(gx.shape)
        if self._factor is not None:
            rhs = divergence(gx, gy, *self.weights)
            x.reshape(-1)[self._free] = self._factor.solve(rhs.ravel()[self._free])
        return PoissonResult(x, 1, 0.0)
