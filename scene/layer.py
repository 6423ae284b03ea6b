"""The elastic layer whose boundary is the mirror: relates a dent to a force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from optolever import InputError

from .record import Record, non_negative, positive

__all__ = ["Layer"]

#: From gels to hard rubber, from films to blocks; the unit, and the one that is typed by mistake.
_PLAUSIBLE = {
    "youngs_modulus_mpa": ((1e-3, 100.0), "MPa (N/mm^2); divide Pa by 1000000, kPa by 1000"),
    "thickness_mm": ((0.05, 1000.0), "mm; multiply metres by 1000"),
}
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
        for key, ((least, most), unit) in _PLAUSIBLE.items():
            value = getattr(self, key)
            if value is not None and not least <= value <= most:
                wrong = f"layer.{key} = {value:g}: must be {least:g} to {most:g}"
                raise InputError(f"{wrong}; its unit is {unit}")
        if (self.youngs_modulus_sigma_mpa or 0.0) > self.youngs_modulus_mpa:
            wrong = f"layer.youngs_modulus_sigma_mpa = {self.youngs_modulus_sigma_mpa:g}"
            limit = f"must be at most the modulus, {self.youngs_modulus_mpa:g}"
            raise InputError(f"{wrong}: {limit}; its unit is MPa, as that of the modulus, not per cent")
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
