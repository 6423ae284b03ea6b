"""Which dents a height map has: maxima by their persistence, and the basin of each.

Pixels are added in the order of their heights. A maximum starts a basin; where the basins of two maxima meet,
at their saddle, the lower one ends (the elder rule of persistent homology; H. Edelsbrunner, J. Harer,
Computational Topology, 2010, ch. VII). It remains a dent if some pixel of it stands out from the saddle by
more than noise can make; otherwise its basin joins its neighbour's. No dent's height decides about another's.
"""

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact

from ..arrays import Floats, Ints, Mask

__all__ = ["basins"]


def basins(z: Floats, sigma: Floats, known: Mask, significance: float) -> tuple[NDArray[np.int64], Ints]:
    """Number of the basin that every pixel belongs to, (H, W), -1 where nothing is known; flat pixel of the
    highest lower bound z - significance sigma in each, (n,), highest first.

    A basin counts if that bound exceeds the upper bound of its saddle.
    """
    places = np.flatnonzero(known)
    order = places[np.argsort(-z.ravel()[places], kind="stable")]
    label = np.full(z.size, -1, np.int64)
    margin = significance * sigma.ravel()
    _flood(order, z.ravel(), margin, z.shape[1], label)
    roots = label[order]
    present = np.bincount(roots, minlength=z.size) > 0
    number = np.cumsum(present)[roots] - 1
    numbers = np.full(z.size, -1, np.int64)
    rising = np.argsort(z.ravel()[order] - margin[order], kind="stable")
    peaks = np.empty(np.count_nonzero(present), np.int64)
    peaks[number[rising]] = order[rising]  # the last one counts: the highest
    ranked = np.argsort(-z.ravel()[peaks], kind="stable")
    numbers[order] = np.argsort(ranked)[number]
    return numbers.reshape(z.shape), peaks[ranked]


@exact
def _flood(order, z, margin, cols, label):  # type: ignore[no-untyped-def]
    """Writes the root of every pixel's basin (flat) to label.

    tree: union-find of connected pixels; lower: the highest lower bound of a tree, at its root; basin:
    union-find of the maxima whose basins are one.
    """
    tree = np.full(z.size, -1, np.int64)
    basin = np.full(z.size, -1, np.int64)
    lower = np.empty(z.size)
    rows = z.size // cols
    for pixel in order:
        tree[pixel] = pixel
        basin[pixel] = pixel
        lower[pixel] = z[pixel] - margin[pixel]
        row, col = pixel // cols, pixel % cols
        highest, at = -np.inf, -1
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(col - 1, 0), min(col + 2, cols)):
                near = r * cols + c
                if near != pixel and tree[near] >= 0 and z[near] > highest:
                    highest, at = z[near], near
        if at < 0:
            label[pixel] = pixel
            continue
        label[pixel] = label[at]
        root = _root(tree, at)
        tree[pixel] = root
        lower[root] = max(lower[root], lower[pixel])
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(col - 1, 0), min(col + 2, cols)):
                near = r * cols + c
                if tree[near] < 0:
                    continue
                one, two = _root(tree, pixel), _root(tree, near)
                if one == two:
                    continue
                if lower[one] < lower[two]:
                    one, two = two, one
                if lower[two] <= z[pixel] + margin[pixel]:
                    kept = _root(basin, label[pixel])
                    if kept == _root(basin, two):
                        kept = _root(basin, label[near])
                    basin[_root(basin, two)] = kept
                tree[two] = one
    for pixel in order:
        label[pixel] = _root(basin, label[pixel])


@exact
def _root(parent, start):  # type: ignore[no-untyped-def]
    """Root of a node; the path is halved on the way."""
    node = start
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node
