"""Records as Python objects: a few lines, a plot, equality; log and progress."""

import logging
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import Correspondence, decode
from optolever.patterns import Sequence, sequence
from optolever.projector import Capture, capture
from optolever.reconstruct import Grid, HeightMap, SlopeMap, curvature_map, reconstruct, slope_map
from optolever.scene import Scene, Trace, dent, load, resize, trace

Chain = tuple[Scene, Sequence, Trace, Capture, Correspondence, HeightMap]


@pytest.fixture(scope="module")
def chain() -> Chain:
    scene = resize(load("paper-simulation", exact=True), 40, 40)
    surface = dent("gaussian", scene)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    seen = capture(scene, surface, shown, renderer="numpy", noise=1.0)
    where = decode(seen.frames, shown)
    return scene, shown, trace(scene, surface), seen, where, reconstruct(where, scene)


@pytest.fixture(scope="module")
def derived(chain: Chain) -> tuple[Grid, SlopeMap]:
    scene, _, _, _, where, height = chain
    return height.resample(), slope_map(height, where, scene)


def test_a_record_is_one_to_five_lines(chain: Chain, derived: tuple[Grid, SlopeMap]) -> None:
    for record in (*chain, *derived):
        lines = repr(record).splitlines()
        assert 1 <= len(lines) <= 5
        assert max(map(len, lines)) <= 160
    where, height = chain[-2:]
    assert f"{100 * where.good.mean():.4g} % good" in repr(where)
    assert f"{height.z[height.good].max():.5g} mm" in repr(height)


def test_equality_is_of_what_is_held_and_never_raises(chain: Chain, derived: tuple[Grid, SlopeMap]) -> None:
    _, _, truth, _, where, height = chain
    assert where == replace(where, u=where.u.copy())
    assert where != replace(where, u=where.u + 1e-3)
    assert where != replace(where, amplitude=None)
    assert height == replace(height, z=height.z.copy())  # NaN where nothing is known
    assert height != replace(height, sigma=2 * height.sigma)
    assert truth == replace(truth, u=truth.u.copy())
    assert all(record == replace(record) for record in derived)
    assert derived[0] != replace(derived[0], pitch=1.0)
    assert (where == height) is False
    assert where != "a correspondence"


def test_maps_of_other_shapes_or_types_are_refused(chain: Chain) -> None:
    where = chain[-2]
    for other, words in (
        ({"sigma_u": np.zeros((3, 3))}, r"sigma_u has shape \(3, 3\), must be H \(40\) x W \(40\)"),
        ({"flags": np.zeros(where.u.shape)}, "flags is float64, must be integer"),
    ):
        with pytest.raises(InputError, match=words):
            replace(where, **other)


def test_records_come_back_from_their_files(
    chain: Chain, derived: tuple[Grid, SlopeMap], tmp_path: Path
) -> None:
    """Equal to what was saved; a file that lacks a field is named with it, as is one that is not there."""
    _, _, truth, _, where, height = chain
    for record in (truth, where, height, *derived, curvature_map(derived[1])):
        path = tmp_path / f"{type(record).__name__}.npz"
        record.save(path)
        again = type(record).load(path)
        if isinstance(record, HeightMap):  # maps are float32 in its file
            np.testing.assert_allclose(again.z, record.z, rtol=1e-7, atol=0)
            again.save(path)
            record = again
        assert type(record).load(path) == record
        with np.load(path) as archive:
            name, *others = archive.files
            np.savez(tmp_path / "less.npz", **{other: archive[other] for other in others})
        with pytest.raises(InputError, match=rf"less\.npz: field '{name}' is missing"):
            type(record).load(tmp_path / "less.npz")
        with pytest.raises(InputError, match=r"none\.npz: no such file"):
            type(record).load(tmp_path / "none.npz")


def test_a_field_that_is_not_what_its_record_holds_is_named(chain: Chain, tmp_path: Path) -> None:
    """By its header: a header that lies is refused before the field is unpacked."""
    chain[-1].save(tmp_path / "h.npz")
    with np.load(tmp_path / "h.npz") as archive:
        whole = dict(archive)
    path = tmp_path / "bad.npz"
    np.savez(path, **whole | {"own": np.zeros(2)})
    with pytest.raises(InputError, match=r"bad\.npz: field 'own' has shape \(2,\), must be \(\)"):
        HeightMap.load(path)
    header = np.lib.format.header_data_from_array_1_0(whole["z"]) | {"shape": (10**6, 10**6)}
    with zipfile.ZipFile(path, "w") as archive:
        for name in whole:
            with archive.open(f"{name}.npy", "w") as stream:
                np.lib.format.write_array_header_1_0(stream, header)
    with pytest.raises(
        InputError, match=r"bad\.npz: field 'x' is float32 of shape \(1000000, 1000000\), not"
    ):
        HeightMap.load(path)


def test_records_are_drawn(chain: Chain, derived: tuple[Grid, SlopeMap]) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    for record in (*chain[1:], *derived):
        axes = record.plot()
        assert all(ax.images and ax.get_title() for ax in axes)
    assert chain[0].plot().get_xlabel() == "x [mm]"
    pyplot.close("all")


def test_long_calls_tell_how_far_they_are(chain: Chain, caplog: pytest.LogCaptureFixture) -> None:
    scene, shown, _, seen, where, _ = chain
    told: list[tuple[str, int, int]] = []

    def listen(text: str, done: int, total: int) -> None:
        told.append((text, done, total))

    with caplog.at_level(logging.INFO, logger="optolever"):
        for call in (
            lambda: capture(scene, dent("flat", scene), shown, renderer="numpy", progress=listen),
            lambda: decode(seen.frames, shown, progress=listen),
            lambda: reconstruct(where, scene, progress=listen),
        ):
            told.clear()
            call()
            counts = [done for _, done, _ in told]
            assert counts == sorted(counts)
            assert told[-1][1] == told[-1][2]
            assert all(text for text, _, _ in told)
    told_of = [record.getMessage().split()[0] for record in caplog.records if record.levelno == logging.INFO]
    assert told_of == ["capture", "decode", "reconstruct"]
