"""Heights from increments between pixels by dense least squares."""

import numpy as np


def dense_solution(gx: np.ndarray, gy: np.ndarray, wx: np.ndarray, wy: np.ndarray) -> np.ndarray:
    """gx, wx: increments and weights of the edges to the next pixel of the row; gy, wy: of the column."""
    pixel, along, down = np.arange(wx.size).reshape(wx.shape), wx > 0, wy > 0
    tail = np.concatenate([pixel[along], pixel[down]])
    head = np.concatenate([tail[: along.sum()] + 1, tail[along.sum() :] + wx.shape[1]])
    differences = np.eye(wx.size)[head] - np.eye(wx.size)[tail]
    root = np.sqrt(np.concatenate([wx[along], wy[down]]))
    rise = np.concatenate([gx[along], gy[down]])
    return np.linalg.lstsq(root[:, None] * differences, root * rise, rcond=1e-14)[0].reshape(wx.shape)
