"""The elastic layer whose boundary is the mirror: relates a dent to a force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from optolever import InputError

from .record import Record, non_negative, positive

__all__ = ["Layer"]

_TYPED = 0.1  # of a silicone's modulus from a data sheet or by hardness


@dataclass(frozen=True, eq=False)
class Layer(Record, section="layer"):
    """Bonded to a rigid base; thickness_mm None: a half-space; youngs_modulus_mpa: N/mm^2, with its standard
    deviation (None: a tenth, as of a typed number); poisson: up to 0.5."""

    youngs_modulus_mpa: Annotated[float, positive]
    poisson: Annotated[float, non_negative] = 0.5
    thickness_mm: Annotated[float | None, positive] = None
    youngs_modulus_sigma_mpa: Annotated[float | None, non_negative] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.poisson > 0.5:
            raise InputError(f"layer.poisson = {self.poisson:g}: must be 0 to 0.5")

    @property
    def relative_sigma(self) -> float:
        """Standard deviation of the modulus over the modulus."""
        sigma = self.youngs_modulus_sigma_mpa
        return _TYPED if sigma is None else sigma / self.youngs_modulus_mpa

    @property
    def plane_modulus(self) -> float:
        """E / (1 - nu^2), N/mm^2."""
        return self.youngs_modulus_mpa / (1 - self.poisson**2)
