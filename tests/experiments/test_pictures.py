"""Pictures: right way round, nothing averaged that should not be, limits that hold."""

import base64

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Flag
from optolever.experiments.flag_table import MEANING
from optolever.experiments.maps import VERTICES, MirrorGrid, surface_data
from optolever.reconstruct import HeightFlag, HeightMap

Floats = NDArray[np.float64]


def test_mirror_grid_puts_values_where_they_are() -> None:
    """A camera whose columns run against x, as on the prism."""
    rows, cols = 40, 60
    y, x = np.mgrid[0:rows, 0:cols].astype(float)
    x = x[:, ::-1] * 0.5
    grid = MirrorGrid.around(x, y, 520)
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


@pytest.mark.parametrize("radius", [np.inf, 400.0])
def test_the_drawn_surface_has_the_heights_of_its_vertices(radius: float) -> None:
    """A tilted plane and a sphere, pixels turned and uneven; a hole."""

    def height(x: Floats, y: Floats) -> Floats:
        bent = 0.0 if np.isinf(radius) else radius - np.sqrt(radius**2 - (x - 20) ** 2 - (y - 10) ** 2)
        return np.asarray(0.1 * x - 0.05 * y + bent)

    row, col = np.mgrid[0:400, 0:300].astype(float)
    x = 0.15 * col + 0.02 * row + 0.3 * np.sin(0.03 * row)
    y = 0.12 * row - 0.03 * col
    flags = np.zeros(x.shape, np.uint16)
    flags[100:130, 50:90] = 1
    data = surface_data(HeightMap(x, y, height(x, y), np.full(x.shape, 2e-5), flags), "height", False)
    shape = data["ny"], data["nx"]
    at_x, at_y = np.meshgrid(*(data[f"{a}0"] + np.arange(data[f"n{a}"]) * data[f"d{a}"] for a in "xy"))
    drawn, colour, sigma = (
        np.frombuffer(base64.b64decode(text), "<f4").reshape(shape)
        for text in (data["z"], *(layer["data"] for layer in data["layers"]))
    )
    known = np.isfinite(drawn)
    assert max(shape) <= VERTICES + 1
    assert 0.5 < known.mean() < 0.95
    assert np.abs(drawn - height(at_x, at_y))[known].max() < 1e-5
    assert np.array_equal(colour[known], drawn[known])
    assert (data["layers"][1]["unit"], sigma[known].mean()) == ("nm", pytest.approx(20, rel=0.2))
