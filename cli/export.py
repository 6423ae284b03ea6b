"""`optolever export`: a height map in other programs' formats.

$ optolever export h.npz h.stl h.sdf h.dat h.xyz --pitch 0.5
Exported h.npz
  h.stl  1.038 MB
  h.sdf  0.1395 MB
  h.dat  0.04237 MB
  h.xyz  0.319 MB
"""

from pathlib import Path
from typing import Annotated

import optolever as ol

from .arguments import ABOVE_0, Arg, Opt, program
from .options import Json, blame
from .outputs import HEIGHT_SUFFIXES, OutputFile
from .printing import number, possible, table, write_json

PITCH = Opt("--pitch MM", "Pitch of the regular grid; default: about that of the camera's pixels.", ABOVE_0)


@program("export", __doc__)
def command(
    source: Annotated[Path, Arg("H.npz")],
    files: Annotated[tuple[Path, ...], Arg("FILE...", OutputFile(*HEIGHT_SUFFIXES, bare=False))],
    pitch: Annotated[float | None, PITCH] = None,
    json_path: Json = None,
) -> None:
    """Write a height map in other programs' formats.

    By the suffix: .npz, .tif (float32), .ply and .stl (mesh), .xyz (points) of the camera's pixels; .x3p,
    .sdf (ISO 25178), .dat (Zygo MetroPro), .wft (DFTFringe, of a disc), .csv and .npy of a regular grid. Good
    pixels only. With --pitch .npz and .tif are on the grid, too. H.npz may also be such a grid, whose points
    and pitch are kept where no other is asked. A file
    whose format cannot hold the heights is named, and the others are written.
    """
    height, grid = ol.metrology.load_measured(source), ol.metrology.grid_of(source)

    def write(path: Path) -> None:
        same = grid is not None and pitch is None and path.suffix.lower() in ol.reconstruct.GRID_FORMATS
        grid.export(path) if grid is not None and same else height.export(path, pitch)

    with ol.files.together(), blame(source):
        files = possible(files, write)
        write_json(json_path, {"files": [str(path) for path in files]})
    sizes = {str(path): number(path.stat().st_size / 1e6, "MB") for path in files if path.is_file()}
    table(f"Exported {source}", sizes)
