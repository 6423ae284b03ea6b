"""Contact: one dent and what was measured of it."""

from dataclasses import dataclass
from typing import Any

from ..arrays import Floats

__all__ = ["Contact"]


@dataclass(frozen=True, slots=True)
class Contact:
    """One dent. Lengths in mm; sigma: standard deviations by noise and by the errors of the rig.

    found: whether the slopes show the edge of a contact; evidence: in words.
    x, y, depth: of the deepest point. depth: its height over the surface at rest, z = 0, from which errors of
    the rig are taken off as far as the map shows them (see `relief`). Tails of other dents are part of it.
    depth_noise: the part of depth_sigma that is no error of the rig.
    area, volume, centroid (x, y): of the contact if one is found, else of the pixels deeper than half the
    depth; volume_sigma is an upper bound: the height's error is taken as common to the area;
    centroid_sigma: along either axis, the root mean square of both.
    cut: the image's edge or flagged pixels end the area: area and volume are those of its visible part, lower
    bounds, and their sigmas include the rest of the circle about the deepest point.
    interpolated: share of the area whose pixels were flagged.
    With an edge: edge (N, 2): points around the contact; edge_share: height there over the depth (Hertz: 0.5,
    flat punch: 1); indenter_radius: of the surface inside, inf where it is flat, None where unknown.
    """

    found: bool
    evidence: str
    x: float
    y: float
    depth: float
    depth_sigma: float
    area: float
    area_sigma: float
    volume: float
    volume_sigma: float
    centroid: tuple[float, float]
    centroid_sigma: float
    edge: Floats
    edge_share: float | None = None
    indenter_radius: float | None = None
    indenter_radius_sigma: float | None = None
    x_sigma: float | None = None
    y_sigma: float | None = None
    depth_noise: float | None = None
    cut: bool = False
    interpolated: float = 0.0

    @property
    def region(self) -> str:
        """What area, volume and centroid belong to."""
        return "contact" if self.found else "half depth"

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        names = [name for name in self.__slots__ if name != "edge"]
        return {name: getattr(self, name) for name in names} | {
            "region": self.region,
            "edge": self.edge.tolist(),
        }
