"""Pictures: right way round, nothing averaged that should not be, limits that hold."""

import base64
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode import Flag
from optolever.experiments.flag_table import MEANING, flag_index, flag_rows
from optolever.experiments.images import MirrorGrid, robust_limits, thumbnail
from optolever.experiments.maps import VERTICES, surface_data
from optolever.experiments.page import percent, scientific, seconds_text, share_text
from optolever.quantities import length_unit
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


def test_mirror_grid_keeps_holes() -> None:
    y, x = np.mgrid[0:50, 0:50].astype(float)
    z = x.copy()
    z[20:30, 20:30] = np.nan
    grid = MirrorGrid.around(x, y)
    assert np.isnan(grid.place(z)).sum() * grid.pitch**2 == pytest.approx(100, rel=0.4)


def test_thumbnail_of_more_than_eight_bits() -> None:
    frame = np.array([[0, 4095], [2048, 1024]], dtype=np.uint16)
    assert thumbnail(frame, 10).tolist() == [[0, 255], [128, 64]]
    assert max(thumbnail(np.zeros((300, 500), np.uint8), 100).shape) == 100


def test_robust_limits() -> None:
    values = np.append(np.linspace(0, 1, 10_000), [np.nan, 1e9])
    low, high = robust_limits(values)
    assert 0 <= low < 0.01
    assert 0.98 < high <= 1.0
    assert robust_limits(-values, symmetric=True)[0] == -robust_limits(-values, symmetric=True)[1]
    assert robust_limits(np.array([np.nan])) == (0.0, 1.0)
    low, high = robust_limits(np.ones(5))
    assert low < 1 < high


def test_units_and_words() -> None:
    assert length_unit(2.0) == (1.0, "mm")
    assert length_unit(2e-3) == length_unit(-2e-3) == (1e3, "µm")
    assert length_unit(2e-6) == (1e6, "nm")
    assert scientific(3.21e-5) == "3.2 × 10⁻⁵"
    assert scientific(-4e-9) == "−4.0 × 10⁻⁹"
    assert scientific(float("nan")) == "–"
    assert percent(0.9512) == "95.12 %"
    assert share_text(-0.0123) == "−1.23 %"
    assert seconds_text(0.0042) == "4.2 ms"


def test_every_flag_has_words() -> None:
    for member in (*Flag, *HeightFlag):
        assert MEANING[str(member.name)]


def test_flag_rows_count_and_colour() -> None:
    flags = np.array([[0, 1, 0], [1 | 1024, 1024, 64]], dtype=np.uint16)
    rows = flag_rows(flags)
    assert {row.name: row.count for row in rows} == {"good": 2, "dark": 2, "moved": 1, "no anchor": 1}
    assert sum(row.share for row in rows) == pytest.approx(1)
    index = flag_index(flags, [row.bit for row in rows])
    names = np.array([row.name for row in rows])[index]
    assert names.tolist() == [["good", "dark", "good"], ["dark", "no anchor", "moved"]]
    assert len({row.colour for row in rows}) == len(rows)


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


def test_nothing_known_is_drawn_as_nothing() -> None:
    x, y = np.meshgrid(np.arange(5.0), np.arange(4.0))
    data = surface_data(x, y, np.full((4, 5), np.nan), {})
    assert np.isnan(vertices(data)[2]).all()
