"""optolever: patterns on a surface, a mirror that deforms, a camera: from the frames the mirror's height.

The parts, floor by floor (imports run downward only):

| floor | part          | what it does                                                             |
|-------|---------------|--------------------------------------------------------------------------|
| 5     | `cli`         | commands and progress                                                    |
| 4     | `experiments` | demo, paper tables, benchmarks, report                                   |
| 4     | `calibration` | captures of simple targets -> Scene with covariance                        |
| 3     | `reconstruct` | Correspondence + Scene -> HeightMap                                      |
| 2     | `projector`   | shows a Sequence, brings frames back: virtual sensor, folder             |
| 2     | `decode`      | frames + Sequence -> Correspondence                                      |
| 1     | `patterns`    | codes: Frame, Sequence                                                   |
| 1     | `scene`       | what is physically there, and its exact ray tracing                      |
| 0     | `errors`, `files` | one-line input errors, atomic files                                  |
| 0     | `hdf5`, `pictures` | other programs' arrays and pictures, damaged or not                 |
| 0     | `blocks`, `kernels` | row blocks on threads; how loops are compiled                      |
| 0     | `processes`   | other Pythons that are started, none with the working folder on its path |
| 0     | `memory`, `notices` | maps in memory used again; what a result wants its user to know    |
"""

from importlib.metadata import version as _version

from optolever.errors import InputError

__version__ = _version("optolever")

__all__ = ["InputError", "__version__"]
