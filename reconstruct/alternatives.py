"""Other solvers of the edge problem, beside DCT and conjugate gradients: a sparse factorisation, a march."""

import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from optolever.errors import InputError

from .linear import MaskedEdges, SeparableEdges
from .poisson import Accuracy, PoissonResult

__all__ = ["DirectEdges", "MarchedEdges", "march_variance", "marched"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class DirectEdges(MaskedEdges):
    """Any mask, any weights: normal equations by a sparse factorisation, the first pixel of every component
    pinned. What extreme weights ask for.
    """

    def __init__(self, wx: Floats, wy: Floats, mask: Mask, separable: bool = True) -> None:
        super().__init__(wx, wy, mask)
        index = np.arange(mask.size).reshape(mask.shape)
        across, down = wx[:, :-1] > 0, wy[:-1] > 0
        self._used = across, down
        tail = np.concatenate([index[:, :-1][across], index[:-1][down]])
        head = np.concatenate([index[:, 1:][across], index[1:][down]])
        self._edge_weights = np.concatenate([wx[:, :-1][across], wy[:-1][down]])
        count = tail.size
        rows = np.tile(np.arange(count), 2)
        signs = np.repeat([-1.0, 1.0], count)
        ends = np.concatenate([tail, head])
        difference = scipy.sparse.csr_array((signs, (rows, ends)), shape=(count, mask.size))
        pinned = np.zeros(mask.size, dtype=np.bool_)
        pinned[np.unique(scipy.ndimage.label(mask)[0].ravel(), return_index=True)[1]] = True
        self._free = np.flatnonzero(mask.ravel() & ~pinned)
        self._difference = difference[:, self._free].tocsc()
        self._factor = None
        if self._free.size:
            normal = self._difference.T @ scipy.sparse.diags_array(self._edge_weights) @ self._difference
            self._factor = scipy.sparse.linalg.splu(
                normal.tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )

    def solve(self, gx: Floats, gy: Floats, accuracy: Accuracy, start: Floats | None = None) -> PoissonResult:
        """One direct solve."""
        x = np.zeros(gx.shape)
        if self._factor is not None:
            across, down = self._used
            data = np.concatenate([gx[:, :-1][across], gy[:-1][down]])
            x.reshape(-1)[self._free] = self._factor.solve(self._difference.T @ (self._edge_weights * data))
        return PoissonResult(x, 1, 0.0)


class MarchedEdges(SeparableEdges):
    """Full rectangle: sums down the column whose edges weigh most, and from there along every row."""

    def __init__(self, wx: Floats, wy: Floats, mask: Mask, separable: bool = True) -> None:
        if not mask.all():
            hidden = int(np.count_nonzero(~mask))
            raise InputError(f"method = 'march': needs a full rectangle, {hidden} pixels of it are missing")
        super().__init__(wx, wy)
        self.spine = int(np.argmax(wy[:-1].sum(axis=0)))

    def solve(self, gx: Floats, gy: Floats, accuracy: Accuracy, start: Floats | None = None) -> PoissonResult:
        """Sums; what the other columns' edges say is not asked."""
        return PoissonResult(marched(gx, gy, self.spine), 1, 0.0)


def marched(gx: Floats, gy: Floats, spine: int = 0) -> Floats:
    """Sums of edge increments down the column `spine` and from there along the rows, (rows, cols)."""
    x = np.zeros(gx.shape)
    x[:, 1:] = np.cumsum(gx[:, :-1], axis=1)
    x -= x[:, spine : spine + 1]
    x[1:] += np.cumsum(gy[:-1, spine])[:, None]
    return x


def march_variance(wx: Floats, wy: Floats, spine: int, pixel: NDArray[np.int64], share: Floats) -> Floats:
    """Variance of a potential marched over edges of weights wx, wy (rows, cols), pinned by anchors of shares
    at pixels (M,) each.

    Every edge of the path adds its own 1/w; an error down the spine counts with the share of the anchors on
    the other side of it. What the anchors' own rows add between them is left out where there are several.
    """
    rows, cols = wx.shape
    along = np.zeros((rows, cols))
    along[:, 1:] = np.cumsum(1.0 / wx[:, :-1], axis=1)
    away: Floats = np.abs(along - along[:, spine : spine + 1])
    step = 1.0 / wy[:-1, spine]
    below = np.zeros(rows)
    np.add.at(below, pixel // cols, share)
    beyond = np.cumsum(below[::-1])[::-1][1:]  # the anchors' share after every edge of the spine
    before = np.concatenate([[0.0], np.cumsum(step * (1.0 - beyond) ** 2)])
    after = np.concatenate([np.cumsum((step * beyond**2)[::-1])[::-1], [0.0]])
    start = away.ravel()[pixel] @ share**2
    variance: Floats = away + (before + after)[:, None] + start
    return variance
