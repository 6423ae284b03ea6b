"""Contacts of a frame with an identity, and their identities with those of the last frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from optolever.contact import Contact

__all__ = ["Force", "Touch", "Touches", "forces_of"]

_SAME = 3.0  # mm from frame to frame, beyond the contact's radius: two that merge lie there


@dataclass(frozen=True, slots=True)
class Touch(Contact):
    """One contact of a frame, see `contact.Contact`; identity: the same from frame to frame."""

    identity: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Plain values; a flat indenter has no radius."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return values | {"indenter_radius": self.indenter_radius if self.indenter_radius_sigma else None}


@dataclass(frozen=True, slots=True)
class Force:
    """Force on one contact: newton (N), with its sigma by the height's errors and the modulus; peak: largest
    pressure, N/mm^2."""

    identity: int
    newton: float
    sigma: float
    peak: float


class Touches:
    """Identities frame by frame: each contact's is that of the nearest one in the last frame."""

    def __init__(self) -> None:
        self._last: tuple[Touch, ...] = ()
        self._next = 1

    def named(self, contacts: Sequence[Contact]) -> tuple[Touch, ...]:
        """The contacts of the next frame, in their order."""
        named = []
        free = list(self._last)
        for contact in contacts:
            near = min(free, key=lambda one, at=contact: _apart(one, at), default=None)  # type: ignore[misc]
            if near is not None and _apart(near, contact) < _SAME + contact.radius:
                free.remove(near)
                identity = near.identity
            else:
                identity, self._next = self._next, self._next + 1
            named.append(Touch(**contact.to_dict(), identity=identity))
        self._last = tuple(named)
        return self._last


def forces_of(touches: Sequence[Touch]) -> tuple[Force, ...]:
    """Of contacts whose elastic layer is known."""
    return tuple(
        Force(one.identity, one.force, one.force_sigma or math.nan, one.pressure or 0.0)
        for one in touches
        if one.force is not None
    )


def _apart(one: Contact, other: Contact) -> float:
    return math.dist((one.x, one.y), (other.x, other.y))
