"""The elastic layer whose boundary is the mirror: relates a dent to a force."""

from dataclasses import dataclass

from optolever import InputError

from .record import Record, freeze, number, positive

__all__ = ["Layer"]


@dataclass(frozen=True, eq=False)
class Layer(Record):
    """Bonded to a rigid base; thickness_mm None: a half-space; youngs_modulus_mpa: N/mm^2, with its standard
    deviation; poisson: up to 0.5."""

    youngs_modulus_mpa: float
    poisson: float = 0.5
    thickness_mm: float | None = None
    youngs_modulus_sigma_mpa: float = 0.0

    def __post_init__(self) -> None:
        modulus = positive("layer.youngs_modulus_mpa", self.youngs_modulus_mpa)
        poisson = number("layer.poisson", self.poisson)
        if not 0 <= poisson <= 0.5:
            raise InputError(f"layer.poisson = {poisson:g}: must be 0 to 0.5")
        thickness = self.thickness_mm
        if thickness is not None:
            thickness = positive("layer.thickness_mm", thickness)
        sigma = positive("layer.youngs_modulus_sigma_mpa", self.youngs_modulus_sigma_mpa, zero=True)
        values = {"youngs_modulus_mpa": modulus, "youngs_modulus_sigma_mpa": sigma}
        freeze(self, poisson=poisson, thickness_mm=thickness, **values)

    @property
    def plane_modulus(self) -> float:
        """E / (1 - nu^2), N/mm^2."""
        return self.youngs_modulus_mpa / (1 - self.poisson**2)
