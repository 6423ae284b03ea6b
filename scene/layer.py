"""The elastic layer whose boundary is the mirror: relates a dent to a force."""

from dataclasses import dataclass

from optolever import InputError

from .record import Record, freeze, number, positive

__all__ = ["Layer"]

_TYPED = 0.1  # of a silicone's modulus from a data sheet or by hardness


@dataclass(frozen=True, eq=False)
class Layer(Record):
    """Bonded to a rigid base; thickness_mm None: a half-space; youngs_modulus_mpa: N/mm^2, with its standard
    deviation (None: a tenth, as of a typed number); poisson: up to 0.5."""

    youngs_modulus_mpa: float
    poisson: float = 0.5
    thickness_mm: float | None = None
    youngs_modulus_sigma_mpa: float | None = None

    def __post_init__(self) -> None:
        modulus = positive("layer.youngs_modulus_mpa", self.youngs_modulus_mpa)
        poisson = number("layer.poisson", self.poisson)
        if not 0 <= poisson <= 0.5:
            raise InputError(f"layer.poisson = {poisson:g}: must be 0 to 0.5")
        thickness = self.thickness_mm
        if thickness is not None:
            thickness = positive("layer.thickness_mm", thickness)
        sigma = self.youngs_modulus_sigma_mpa
        if sigma is not None:
            sigma = positive("layer.youngs_modulus_sigma_mpa", sigma, zero=True)
        values = {"youngs_modulus_mpa": modulus, "youngs_modulus_sigma_mpa": sigma}
        freeze(self, poisson=poisson, thickness_mm=thickness, **values)

    @property
    def relative_sigma(self) -> float:
        """Standard deviation of the modulus over the modulus."""
        sigma = self.youngs_modulus_sigma_mpa
        return _TYPED if sigma is None else sigma / self.youngs_modulus_mpa

    @property
    def plane_modulus(self) -> float:
        """E / (1 - nu^2), N/mm^2."""
        return self.youngs_modulus_mpa / (1 - self.poisson**2)
