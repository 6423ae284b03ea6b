"""The display's side of a world that is not there: Xvfb's frame buffer and keys, the optics to the camera."""

import ctypes
import mmap
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from optolever import projector, scene
from optolever.projector.footprint import _shares

ENTER, ESCAPE, LEFT, RIGHT = 0xFF0D, 0xFF1B, 0xFF51, 0xFF53  # X keysyms


def press(display: str, key: int) -> None:
    """A key of the X server, down and up."""
    x11, test = ctypes.CDLL("libX11.so.6"), ctypes.CDLL("libXtst.so.6")
    x11.XOpenDisplay.restype = ctypes.c_void_p
    server = ctypes.c_void_p(x11.XOpenDisplay(display.encode()))
    for down in (1, 0):
        test.XTestFakeKeyEvent(server, x11.XKeysymToKeycode(server, key), down, 0)
    x11.XCloseDisplay(server)


class FrameBuffer:
    """Xvfb -fbdir: an XWD file that the server keeps mapped. colours: blue, green, red."""

    def __init__(self, folder: Path, rows: int, cols: int) -> None:
        with (folder / "Xvfb_screen0").open("rb") as file:
            self._map = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
        header = np.frombuffer(self._map, ">u4", 25)
        start, high, stride = int(header[0]) + 12 * int(header[19]), int(header[5]), int(header[12])
        screen = np.frombuffer(self._map, np.uint8, high * stride, start).reshape(high, stride)
        self.colours = screen[:rows, : 4 * cols].reshape(rows, cols, 4)[..., :3]
        self.pixels = self.colours[..., 1]


class Optics:
    """Light (rows, cols) of any image of the display on the camera's pixels: a sum over their footprints."""

    def __init__(self, rig: scene.Scene, surface: scene.Surface) -> None:
        seen, pattern = projector.footprints(rig, surface, 0, rig.camera.rows), rig.pattern
        cells, shares, starts = [], [], [0]
        for look, light in zip(seen.along("u"), seen.light, strict=True):
            if light > 0:
                u, of_u = _shares(*look[:3], pattern.blur_px, pattern.cols)
                v, of_v = _shares(*look[3:], pattern.blur_px, pattern.rows)
                at = np.add.outer((v + np.arange(of_v.size)) * pattern.cols, u + np.arange(of_u.size))
                cells.append(at.ravel())
                shares.append(light * np.outer(of_v, of_u).ravel())
            starts.append(starts[-1] + (shares[-1].size if light > 0 else 0))
        table = np.concatenate(shares), np.concatenate(cells), starts
        self._table = csr_array(table, shape=(seen.light.size, pattern.rows * pattern.cols))
        self._shape = rig.camera.rows, rig.camera.cols

    def __call__(self, image: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(self._table @ image.ravel()).reshape(self._shape)
