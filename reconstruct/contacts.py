"""Contacts of a height map, see `optolever.contact`."""

from dataclasses import replace

import numpy as np

from optolever.contact import Contact, elastic_fits, load_fit, regions
from optolever.contact import contacts as figures
from optolever.scene import Layer

from .heightmap import HeightFlag, HeightMap
from .load import surface_of

__all__ = ["contacts"]


def contacts(height: HeightMap, layer: Layer | None = None) -> tuple[Contact, ...]:
    """Contacts, the deepest first: cells deeper than half of a peak that rises above the surface at rest by
    six standard deviations; last those whose depth is below three of its own (at a hole, or by the rig's
    errors); layer: elastic, for the forces.

    In a map without a rest capture, errors of the rig that show in most of the map are removed first. Only
    pixels without a flag, or with STEEP alone, are used.
    """
    usable = (height.flags & ~np.uint16(HeightFlag.STEEP)) == 0
    usable &= np.isfinite(height.z) & np.isfinite(height.sigma)
    if not usable.any():
        return ()
    surface = replace(surface_of(height, height.free), good=usable)
    if not height.against_rest and (height.count or height.free is not None):
        surface = replace(surface, motions=height.count)
        found = load_fit(surface, layer, solid=height.free is None)
        surface = surface if found is None else surface.less(found)
    dents = regions(surface)
    return figures(surface, dents, layer, elastic_fits(surface, dents, layer))
