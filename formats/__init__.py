"""formats: files of other programs. Measurements and rigs of OpenCSP's SOFAST (HDF5; extra `sofast`).

| file | holds |
|---|---|
| `sofast_files.py` | fields of SOFAST's files, with their shapes checked |
| `sofast_rig.py` | the rig of a result, or of its inputs, as a scene |
| `sofast_measurement.py` | a measurement as a capture, its response, and what was decoded on its rig |
"""

from optolever.arguments import check_face

from .sofast_measurement import load_sofast, load_sofast_response, on_rig
from .sofast_rig import SOFAST_SCREEN, SofastRig, load_sofast_rig

__all__ = ["SOFAST_SCREEN", "SofastRig", "load_sofast", "load_sofast_response", "load_sofast_rig", "on_rig"]

check_face(__name__)
