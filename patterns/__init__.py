"""Patterns of a surface: codes, frames, sequences. The decoder goes by these descriptions, never by position.

| file        | holds                                                                 |
|-------------|-----------------------------------------------------------------------|
| `frame`     | `Frame`, one image described completely; its tables of grey values     |
| `codes`     | binary code words: binary, Gray, long-run Gray                         |
| `long_run`  | Gray codes without narrow stripes                                      |
| `channels`  | `Packing`: which frame each channel of each exposure shows              |
| `packing`   | `packed`: a sequence in colour, in a third of the exposures           |
| `sequence`  | `Sequence`: frames and surface size; images, PNG export                |
| `named`     | `sequence("gray+phase", rows, cols, ...)` and its command-line form    |

Pattern coordinates: u along columns, v along rows, integer = pixel centre.
"""

from .channels import STRIPES, Packing
from .codes import BINARY_CODES, bits_for, code_words
from .frame import KINDS, Frame, frame_tables, lattice_lines
from .named import sequence, sequence_from_text, sequence_names, sequence_parameters
from .packing import packed
from .sequence import Sequence

__all__ = [
    "BINARY_CODES", "KINDS", "STRIPES", "Frame", "Packing", "Sequence", "bits_for",
    "code_words", "frame_tables", "lattice_lines", "packed", "sequence", "sequence_from_text",
    "sequence_names", "sequence_parameters",
]  # fmt: skip
