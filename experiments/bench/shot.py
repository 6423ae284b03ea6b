"""Shot: a mirror, its truth, and the frames that its camera took of a sequence.

A single shot (crossed fringes) is followed from the mirror at rest, which is captured before: the same frame,
and where every pixel looks, by a dense sequence.
"""

from dataclasses import dataclass

from optolever.decode import Correspondence, decode
from optolever.errors import InputError
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import Capture, capture
from optolever.scene import Surface, dent

from ..place import Place
from ..timing import timed
from .cell import Cell

__all__ = ["Rest", "Shot", "place_of", "shoot"]

AT_REST = "gray+phase:steps=8"


@dataclass(frozen=True, slots=True)
class Rest:
    """The mirror at rest: the frames of a single shot, and the correspondence of a dense sequence."""

    capture: Capture
    seen: Correspondence


@dataclass(frozen=True, slots=True)
class Shot:
    """Frames of a place; capture None where the sequence is 'exact' (no frames) or shown otherwise
    ('lattice'); rest: only of a single shot.
    """

    place: Place
    cell: Cell
    sequence: Sequence | None
    capture: Capture | None
    render_seconds: float
    rest: Rest | None = None

    def taken(self) -> tuple[Capture, Sequence]:
        """The frames and what they show; InputError where there are none."""
        if self.capture is None or self.sequence is None:
            raise InputError(f"sequence {self.cell.shown!r}: no frames, this decoder needs some")
        return self.capture, self.sequence

    @property
    def count(self) -> int:
        """Frames of the dented mirror."""
        return 0 if self.sequence is None else len(self.sequence)


def place_of(cell: Cell) -> Place:
    """The cell's mirror, traced. InputError for names that do not exist."""
    return Place.of(cell.scene, cell.dent, cell.size)


def shoot(place: Place, cell: Cell) -> Shot:
    """The cell's frames, with its own noise."""
    if cell.shown == "exact":
        return Shot(place, cell, None, None, 0.0)
    pattern = place.scene.pattern
    sequence = sequence_from_text(cell.shown, pattern.rows, pattern.cols)
    if sequence.name == "lattice":
        return Shot(place, cell, sequence, None, 0.0)
    taken = timed(lambda: _captured(place, place.surface, sequence, cell, 0))
    single = all(frame.kind == "crossed" for frame in sequence.frames)
    rest = _rest(place, sequence, cell) if single else None
    return Shot(place, cell, sequence, taken.value, taken.seconds, rest)


def _captured(place: Place, surface: Surface, shown: Sequence, cell: Cell, offset: int) -> Capture:
    """Frames with the cell's noise; offset: of the seed."""
    return capture(
        place.scene,
        surface,
        shown,
        renderer=cell.renderer,
        noise=cell.noise,
        seed=cell.capture_seed + offset,
    )


def _rest(place: Place, shown: Sequence, cell: Cell) -> Rest:
    flat = dent("flat", place.scene)
    dense = sequence_from_text(AT_REST, shown.rows, shown.cols)
    seen = decode(_captured(place, flat, dense, cell, 1).frames, dense)
    return Rest(_captured(place, flat, shown, cell, 2), seen)
