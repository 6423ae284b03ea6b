"""Heights from increments between pixels by dense least squares."""

import numpy as np


def incidence(wx: np.ndarray, wy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dense D (edges x pixels), the edges' weights, and the flat indices of the edges in (x, y) order."""
    rows, kept, index = [], [], []
    for axis, weights in enumerate((wx, wy)):
        for i, j in np.argwhere(weights > 0):
            row = np.zeros(wx.shape)
            row[i, j] = -1
            row[(i, j + 1) if axis == 0 else (i + 1, j)] = 1
            rows.append(row.ravel())
            kept.append(weights[i, j])
            index.append((axis, i, j))
    return np.array(rows), np.array(kept), np.array(index)


def dense_solution(gx: np.ndarray, gy: np.ndarray, wx: np.ndarray, wy: np.ndarray) -> np.ndarray:
    d, w, index = incidence(wx, wy)
    g = np.array([(gx, gy)[axis][i, j] for axis, i, j in index])
    root = np.sqrt(w)[:, None]
    return np.linalg.lstsq(d * root, g * root[:, 0], rcond=1e-14)[0].reshape(wx.shape)
