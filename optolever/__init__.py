"""optolever: patterns on a surface, a mirror that deforms, a camera: from the frames the mirror's height.

The parts, floor by floor (imports run downward only):

| floor | part          | what it does                                                             |
|-------|---------------|--------------------------------------------------------------------------|
| 6     | `cli`         | commands and progress                                                    |
| 5     | `experiments` | demo, paper tables, benchmarks, report                                   |
| 4     | `calibration` | captures of simple targets -> Scene with covariance                        |
| 4     | `metrology`   | form, residual, slope error, Zernike terms, with sigma                   |
| 4     | `live`        | prepared rig + one frame -> height, contacts, force                        |
| 3     | `reconstruct` | Correspondence + Scene -> HeightMap                                      |
| 2     | `projector`   | shows a Sequence, brings frames back: virtual sensor, folder             |
| 2     | `decode`      | frames + Sequence -> Correspondence                                      |
| 1     | `patterns`    | codes: Frame, Sequence                                                   |
| 1     | `scene`       | what is physically there, and its exact ray tracing                      |
| 0     | `errors`, `files` | one-line input errors, atomic files                                  |
| 0     | `arguments`   | records of a wrong type, named at every face                             |
| 0     | `hdf5`, `pictures`, `toml` | other programs' arrays, pictures and text, damaged or not   |
| 0     | `blocks`, `kernels` | row blocks on threads; how loops are compiled                      |
| 0     | `processes`   | other Pythons that are started, none with the working folder on its path |
| 0     | `records`     | equality, a few lines and a plot of what holds arrays; the logger          |
| 0     | `memory`, `notices` | memory that is free; what a result wants its user to know           |

`import optolever` is enough: a part is imported when it is asked for, as in `optolever.decode.decode(...)`,
the part `decode` and its function. `logging.getLogger("optolever")` says what they do.
"""

import importlib as _importlib
from importlib.metadata import version as _version
from types import ModuleType as _ModuleType
from typing import TYPE_CHECKING

from optolever.errors import InputError

if TYPE_CHECKING:
    from optolever import (  # noqa: F401  # fmt: skip
        calibration,
        decode,
        experiments,
        files,
        formats,
        live,
        metrology,
        patterns,
        projector,
        reconstruct,
        scene,
    )

__version__ = _version("optolever")

__all__ = ["InputError", "__version__"]

_PARTS = (
    *("calibration", "cli", "decode", "experiments", "files", "formats", "live", "metrology"),
    *("patterns", "projector", "reconstruct", "scene"),
)


def __getattr__(name: str) -> _ModuleType:
    """A part, imported when it is asked for."""
    if name not in _PARTS:
        raise AttributeError(f"module 'optolever' has no attribute {name!r}")
    return _importlib.import_module(f"optolever.{name}")


def __dir__() -> list[str]:
    return [*__all__, *_PARTS]
