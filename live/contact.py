"""Touch and Force: the figures of one contact."""

from dataclasses import dataclass

from .shape import Shape

__all__ = ["Force", "Touch"]


@dataclass(frozen=True, slots=True)
class Touch:
    """One contact; lengths in mm. identity: the same from frame to frame; x, y: centroid of the cells deeper
    than half the depth, position_sigma: of either; area (mm^2), volume (mm^3): of these cells; cut: the
    border or cells without height end them, so that area and volume are lower bounds; hole: cells without
    height are inside, where the depth is continued from the flank: its sigma holds by how much, the force's
    does not; shape: tilt and radii, None of few
    cells. Sigmas are those of noise and of the edge in whole cells; the shape's include its misfit."""

    identity: int
    x: float
    y: float
    position_sigma: float
    depth: float
    depth_sigma: float
    area: float
    area_sigma: float
    volume: float
    volume_sigma: float
    cut: bool
    hole: bool
    shape: Shape | None = None


@dataclass(frozen=True, slots=True)
class Force:
    """On one contact: newton, sigma: by the height's noise and the modulus; peak: largest
    pressure, N/mm^2."""

    identity: int
    newton: float
    sigma: float
    peak: float
