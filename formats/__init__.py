"""formats: files of other programs. Measurements and rigs of OpenCSP's SOFAST (HDF5; extra `sofast`).

| file | holds |
|---|---|
| `sofast_files.py` | fields of SOFAST's files, a measurement as a capture, its response |
| `sofast_rig.py` | the rig of a result, or of its inputs, as a scene; what was decoded on its pattern |
"""

from .sofast_files import SOFAST_SCREEN, load_sofast, load_sofast_response, sofast_facets
from .sofast_rig import SofastRig, load_sofast_rig, on_rig

__all__ = [
    "SOFAST_SCREEN", "SofastRig", "load_sofast", "load_sofast_response", "load_sofast_rig", "on_rig",
    "sofast_facets",
]  # fmt: skip
