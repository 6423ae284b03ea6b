"""optolever: patterns on a surface, a mirror that deforms, a camera: from the frames the mirror's height.

Parts by floor, imports run downward only: 7 `cli`; 6 `design`, `report`; 5 `samples`; 4 `calibration`,
`formats`, `live`, `metrology`; 3 `camera`, `reconstruct`; 2 `contact`, `decode`, `projector`; 1 `patterns`,
`scene`; 0 this folder: `arrays` (and memory for them), `blocks` and `kernels` (threads, compiled loops),
`errors`, `files` (whole or absent), `maps` (heights in other programs' files), `notices`, `numbers`,
`pictures`, `processes`, `quantities`, `records`, `schema` (records from plain values, types and shapes asked
once; records of a wrong type, named at the verbs), `timing`, `toml`.

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
        camera,
        contact,
        decode,
        design,
        files,
        formats,
        live,
        metrology,
        patterns,
        projector,
        reconstruct,
        report,
        samples,
        scene,
    )

__version__ = _version("optolever")

__all__ = ["InputError", "__version__"]

_PARTS = (
    *("calibration", "cli", "contact", "decode", "design", "files", "formats", "live", "metrology"),
    *("camera", "patterns", "projector", "reconstruct", "report", "samples", "scene"),
)


def __getattr__(name: str) -> _ModuleType:
    """A part, imported when it is asked for."""
    if name not in _PARTS:
        raise AttributeError(f"module 'optolever' has no attribute {name!r}")
    return _importlib.import_module(f"optolever.{name}")


def __dir__() -> list[str]:
    return [*__all__, *_PARTS]
