"""Files of heights by other programs, as arrays: z (rows, cols) mm, NaN where unknown, at x = x0 + j pitch,
y = y0 + i pitch.

| file | holds |
|---|---|
| `write.py` | writers of regular grids (`REGULAR`), and of points and meshes (`MESHES`), by suffix |
| `read.py` | `read_grid`: readers of regular grids (`READABLE`) |

| suffix | written | read | keeps |
|---|---|---|---|
| .tif, .tiff | x | x | float32, pitch |
| .x3p (ISO 25178-72) | x | x | float64, pitch, origin |
| .sdf (ISO 25178-71) | x | x | nine digits, pitch |
| .dat (Zygo MetroPro) | x | x | integers, pitch |
| .datx (Zygo Mx) | | x | pitch; needs h5py |
| .wft (DFTFringe) | x | x | waves of 550 nm of a reflected wavefront, pitch |
| .csv | x | x | all digits, pitch, origin |
| .npy | x | x | x, y, z (3, rows, cols), float64 |
"""

from .read import READABLE, GridMap, read_grid
from .write import MESHES, REGULAR, chosen, write_tiff

__all__ = ["MESHES", "READABLE", "REGULAR", "GridMap", "chosen", "read_grid", "write_tiff"]
