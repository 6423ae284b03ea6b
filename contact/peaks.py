"""Which dents a height map has: maxima by their persistence, and the basin of each.

Pixels are added in the order of their heights. A maximum starts a basin; where the basins of two maxima meet,
at their saddle, the lower one ends (the elder rule of persistent homology; H. Edelsbrunner, J. Harer,
Computational Topology, 2010, ch. VII). It remains a dent if some pixel of it stands out from the saddle by
more than noise can make; otherwise its basin joins its neighbour's. No dent's height decides about another's.
"""

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact

from .arrays import Floats, Ints, Mask

__all__ = ["basins"]


def basins(z: Floats, sigma: Floats, known: Mask, significance: float) -> tuple[NDArray[np.int64], Ints]:
    """Number of the basin that every pixel belongs to, (H, W), -1 where nothing is known; flat pixel of the
    highest lower bound z - significance sigma in each, (n,), highest first.

    A basin counts if that bound exceeds the upper bound of its saddle.
    """
    places = np.flatnonzero(known)
    order = places[np.argsort(-z.ravel()[places], kind="stable")]
    label, top = np.full((2, z.size), -1, np.int64)
    _flood(order, z.ravel(), significance * sigma.ravel(), z.shape[1], label, top)
    roots = np.flatnonzero(top >= 0)
    roots = roots[np.argsort(-z.ravel()[top[roots]], kind="stable")]
    number = np.full(z.size + 1, -1, np.int64)  # the last one where nothing is known
    number[roots] = np.arange(roots.size)
    return number[label].reshape(z.shape), top[roots]


@exact
def _flood(order, z, margin, cols, label, top):  # type: ignore[no-untyped-def]
    """Writes the root of every pixel's basin (flat) to label, a root's pixel of highest lower bound to top.

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
        root = _root(basin, label[pixel])
        label[pixel] = root
        if top[root] < 0 or z[pixel] - margin[pixel] > z[top[root]] - margin[top[root]]:
            top[root] = pixel


@exact
def _root(parent, start):  # type: ignore[no-untyped-def]
    """Root of a node; the path is halved on the way."""
    node = start
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node
