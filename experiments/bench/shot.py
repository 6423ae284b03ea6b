"""Shot: a mirror, its truth, and the frames that its camera took of a sequence."""

from dataclasses import dataclass

from optolever.errors import InputError
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import Capture, capture
from optolever.scene import Scene, Surface, Trace, dent_from_text, trace

from ..demo import resolve
from .cell import Cell
from .timing import once

__all__ = ["Place", "Shot", "place_of", "shoot"]


@dataclass(frozen=True, slots=True)
class Place:
    """A dented mirror: scene, shape, and what every pixel truly sees."""

    scene: Scene
    surface: Surface
    truth: Trace


@dataclass(frozen=True, slots=True)
class Shot:
    """Frames of a place; capture None where the sequence is 'exact' (no frames) or shown otherwise
    ('lattice').
    """

    place: Place
    cell: Cell
    sequence: Sequence | None
    capture: Capture | None
    render_seconds: float

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
    scene = resolve(cell.scene, cell.size)
    surface = dent_from_text(cell.dent or scene.dent or "raised-cosine", scene)
    return Place(scene, surface, trace(scene, surface))


def shoot(place: Place, cell: Cell) -> Shot:
    """The cell's frames, with its own noise."""
    if cell.shown == "exact":
        return Shot(place, cell, None, None, 0.0)
    pattern = place.scene.pattern
    sequence = sequence_from_text(cell.shown, pattern.rows, pattern.cols)
    if sequence.name == "lattice":
        return Shot(place, cell, sequence, None, 0.0)
    taken = once(
        lambda: capture(
            place.scene,
            place.surface,
            sequence,
            renderer=cell.renderer,
            noise=cell.noise,
            seed=cell.capture_seed,
        )
    )
    return Shot(place, cell, sequence, taken.value, taken.seconds)
