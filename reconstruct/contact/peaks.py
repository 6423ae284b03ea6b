"""Which dents a height map has: maxima by their persistence, and the basin of each.

Pixels are added in the order of their heights. A maximum starts a basin; where the basins of two maxima meet,
at their saddle, the lower one ends (the elder rule of persistent homology; H. Edelsbrunner, J. Harer,
Computational Topology, 2010, ch. VII). It remains a dent if it stands out from the saddle by more than noise
can make; otherwise its basin joins its neighbour's. No dent's height decides about another's.
"""

import numpy as np
from numpy.typing import NDArray

from optolever.kernels import exact

from ..arrays import Floats, Ints, Mask

__all__ = ["basins"]


def basins(z: Floats, sigma: Floats, known: Mask, significance: float) -> tuple[NDArray[np.int64], Ints]:
    """Number of the maximum that every pixel belongs to, (H, W), -1 where nothing is known; flat pixel of
    every maximum (n,), highest first.

    A maximum counts if it exceeds its saddle by `significance` standard deviations of both heights.
    """
    places = np.flatnonzero(known)
    order = places[np.argsort(-z.ravel()[places], kind="stable")]
    label = np.full(z.size, -1, np.int64)
    _flood(order, z.ravel(), sigma.ravel(), z.shape[1], significance, label)
    peaks, number = np.unique(label[order], return_inverse=True)
    ranks = np.argsort(np.argsort(-z.ravel()[peaks], kind="stable"))
    numbers = np.full(z.size, -1, np.int64)
    numbers[order] = ranks[number]
    return numbers.reshape(z.shape), peaks[np.argsort(ranks)].astype(np.intp)


@exact
def _flood(order, z, sigma, cols, significance, label):  # type: ignore[no-untyped-def]
    """Writes the maximum of every pixel (flat) to label.

    tree: union-find of what is connected so far, roots are its highest pixels; basin: union-find of maxima
    whose basins are one.
    """
    tree = np.full(z.size, -1, np.int64)
    basin = np.full(z.size, -1, np.int64)
    rows = z.size // cols
    for pixel in order:
        tree[pixel] = pixel
        basin[pixel] = pixel
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
        tree[pixel] = _root(tree, at)
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(col - 1, 0), min(col + 2, cols)):
                near = r * cols + c
                if tree[near] < 0:
                    continue
                one, two = _root(tree, pixel), _root(tree, near)
                if one == two:
                    continue
                higher, lower = (one, two) if z[one] >= z[two] else (two, one)
                rise = z[lower] - z[pixel]
                if rise <= significance * np.sqrt(sigma[lower] ** 2 + sigma[pixel] ** 2):
                    other = _root(basin, label[pixel])
                    if other == _root(basin, lower):
                        other = _root(basin, label[near])
                    basin[_root(basin, lower)] = other
                tree[lower] = higher
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
