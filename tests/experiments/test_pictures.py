"""Pictures: right way round, nothing averaged that should not be, limits that hold."""

import base64
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Flag
from optolever.experiments.flag_table import MEANING
from optolever.experiments.images import MirrorGrid
from optolever.experiments.maps import VERTICES, surface_data
from optolever.reconstruct import HeightFlag

Floats = NDArray[np.float64]


def test_mirror_grid_puts_values_where_they_are() -> None:
    """A camera whose columns run against x, as on the prism."""
    rows, cols = 40, 60
    y, x = np.mgrid[0:rows, 0:cols].astype(float)
    x = x[:, ::-1] * 0.5
    grid = MirrorGrid.around(x, y)
    placed = grid.place(x + 100 * y)
    centre_x = grid.x0 + (np.arange(placed.shape[1]) + 0.5) * grid.pitch
    centre_y = grid.y0 + (np.arange(placed.shape[0]) + 0.5) * grid.pitch
    assert np.isfinite(placed).all()
    np.testing.assert_allclose(placed % 100, np.broadcast_to(centre_x, placed.shape), atol=1.5 * grid.pitch)
    np.testing.assert_allclose(
        placed // 100, np.broadcast_to(centre_y[:, None], placed.shape), atol=1.5 * grid.pitch
    )


def test_every_flag_has_words() -> None:
    for member in (*Flag, *HeightFlag):
        assert MEANING[str(member.name)]


def vertices(data: dict[str, Any], layer: int | None = None) -> tuple[Floats, Floats, Floats]:
    """x, y and z, or a layer's value, of what the viewer draws."""
    shape = data["ny"], data["nx"]
    text = data["z"] if layer is None else data["layers"][layer]["data"]
    x, y = data["x0"] + np.arange(shape[1]) * data["dx"], data["y0"] + np.arange(shape[0]) * data["dy"]
    return *np.meshgrid(x, y), np.frombuffer(base64.b64decode(text), "<f4").reshape(shape).astype(float)


@pytest.mark.parametrize("radius", [np.inf, 400.0])
def test_the_drawn_surface_has_the_heights_of_its_vertices(radius: float) -> None:
    """A tilted plane and a sphere, pixels turned and uneven: heights of the nearest pixels made ripples."""

    def height(x: Floats, y: Floats) -> Floats:
        bent = 0.0 if np.isinf(radius) else radius - np.sqrt(radius**2 - (x - 20) ** 2 - (y - 10) ** 2)
        return np.asarray(0.1 * x - 0.05 * y + bent)

    row, col = np.mgrid[0:400, 0:300].astype(float)
    x = 0.15 * col + 0.02 * row + 0.3 * np.sin(0.03 * row)
    y = 0.12 * row - 0.03 * col
    z, error = height(x, y), 3.0 * x - y
    z[100:130, 50:90] = np.nan
    error[:, :200] = np.nan
    layers = {"height": (z, "mm", "viridis", False), "error": (error, "nm", "RdBu_r", True)}
    data = surface_data(x, y, z, layers)
    at_x, at_y, drawn = vertices(data)
    known = np.isfinite(drawn)
    assert max(drawn.shape) <= VERTICES + 1
    assert 0.5 < known.mean() < 0.95
    assert np.abs(drawn - height(at_x, at_y))[known].max() < 1e-5
    for layer, truth in ((0, height(at_x, at_y)), (1, 3.0 * at_x - at_y)):
        _, _, colour = vertices(data, layer)
        drawn_there = known & (colour != np.float32(data["layers"][layer]["low"]))
        assert drawn_there.mean() > 0.1
        assert np.abs(colour - truth)[drawn_there].max() < 1e-4
