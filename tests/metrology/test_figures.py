"""Apertures, filters, PVr, noise of a residual, Zernike indices, runs: closed forms, draws, prysm."""

import json
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.metrology import (
    FormFit,
    ansi_index,
    aperture_mask,
    compare_runs,
    fit_form,
    fit_zernike,
    fringe_index,
    gaussian_filter,
    judge,
    pvr,
    slope_errors,
    zernike,
    zernike_name,
)
from optolever.reconstruct import Diagnostics, HeightMap, integrate

Floats = NDArray[np.float64]
PITCH, ROWS, COLS, NOISE = 2.0, 60, 80, 1e-5
Y, X = (np.asarray(part, np.float64) for part in np.mgrid[0:ROWS, 0:COLS] * PITCH)
MIDDLE = PITCH * (COLS - 1) / 2, PITCH * (ROWS - 1) / 2
WAVE = 40.0


def height_map(z: Any, **more: Any) -> HeightMap:
    flags = np.zeros((ROWS, COLS), np.uint16)
    z = np.asarray(z + 0 * X, np.float64)
    return HeightMap(X, Y, z, np.full(z.shape, 1e-4), flags, **more)


def drawn(seed: int, z: Any = 0.0) -> HeightMap:
    """Integrated white slope noise on a surface."""
    field = NOISE * np.random.default_rng(seed).standard_normal((2, ROWS, COLS))
    return height_map(
        z + integrate(*field, spacing=PITCH).z, diagnostics=Diagnostics("drawn", slope_sigma=(NOISE, NOISE))
    )


PASSES: dict[str, tuple[tuple[float, Any], ...]] = {
    "all": (), "high": ((WAVE, "high"),), "low": ((WAVE, "low"),), "band": ((WAVE, "high"), (20.0, "low")),
}  # fmt: skip


@pytest.mark.daily(2)
@pytest.mark.parametrize("kept", PASSES)
@pytest.mark.parametrize("waves", [(), (15.0, 90.0)])
def test_the_sigmas_of_a_residual_are_what_draws_of_it_are(kept: str, waves: tuple[float, ...]) -> None:
    """Of 40 draws: standard deviations of the pixels (rms over them), of the rms, of Zernike terms (each, and
    rms over them), of surfaces with waves of these lengths (mm), less their power, behind filters."""
    z = sum((3e-4 * np.sin(2 * np.pi * X / wave) for wave in waves), 0.0 * X)
    fits, terms = [], []
    for seed in range(40):
        height = drawn(seed, z)
        fit = fit_form(height, "power")
        for cutoff, which in PASSES[kept]:
            fit = gaussian_filter(fit, cutoff, which)
        fits.append(fit)
        deviation = replace(height, z=fit.residual)
        terms.append(fit_zernike(deviation, 4, removed=None if terms else fit).numbers)
    defocus = terms[0].names.index("Z(2,0)")  # the fit of the power takes off a part of it
    assert terms[0].noise[defocus] < 0.85 * fit_zernike(height, 4).numbers.noise[defocus]
    spread = np.sqrt(np.nanmean(np.var([one.residual for one in fits], axis=0)))
    assert spread / np.sqrt(np.nanmean(fits[0].noise ** 2)) == pytest.approx(1, abs=0.15)
    rms_sigma = np.median([one.rms_sigmas(one.rms)[0] for one in fits])
    assert 0.55 < np.std([one.rms for one in fits]) / rms_sigma < 1.35
    ratio = np.std([one.values for one in terms], axis=0) / terms[0].noise
    assert np.all((ratio > 0.65) & (ratio < 1.4)), ratio
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1, abs=0.12)
    if kept == "all" and waves:
        alone = fit_form(height_map(z), "power").rms
        less = np.array([one.rms_less_noise for one in fits])
        assert 0.55 < less.std() / np.median([one.rms_sigmas(one.rms_less_noise)[0] for one in fits]) < 1.35
        assert less.mean() == pytest.approx(alone, abs=4 * less.std() / np.sqrt(40))
        assert abs(np.mean([one.rms for one in fits]) - alone) > abs(less.mean() - alone)


@pytest.mark.parametrize("kept", ["all", "band"])
@pytest.mark.parametrize("wave", [30.0, 0.0])
def test_a_slope_error_is_that_of_the_surface_alone(kept: str, wave: float) -> None:
    """Of 30 draws of integrated slope noise: the rms of the heights' slopes less noise; its sigma is their
    standard deviation. Where the noise is unknown, so is sigma. wave: mm, 0: a flat surface."""
    z = 4e-5 * np.sin(2 * np.pi * X / wave) + 2e-5 * np.sin(2 * np.pi * Y / 50) if wave else 0.0 * X
    inside = np.pad(np.ones((ROWS - 8, COLS - 8), np.bool_), 4)
    noisy = fit_form(drawn(0, z), "tilt", aperture=inside)

    def filtered(heights: Floats, **more: Any) -> FormFit:
        along_y, along_x = np.gradient(heights, PITCH)
        left = np.where(inside, heights - along_x.mean() * X - along_y.mean() * Y, np.nan)
        fit = replace(noisy, residual=left - np.nanmean(left), **more)
        for cutoff, which in PASSES[kept]:
            fit = gaussian_filter(fit, cutoff, which)
        return fit

    exact = slope_errors(filtered(z, slope_noise=None))
    assert all(np.isnan(one.sigma) for one in exact)
    values = np.array([[one.known for one in slope_errors(filtered(drawn(k, z).z))] for k in range(30)])
    for axis, true in enumerate(one.rms for one in exact):
        rms, sigma, _ = values[:, axis].T
        if wave:
            assert np.mean(rms) == pytest.approx(true, rel=0.02, abs=3 * np.std(rms) / np.sqrt(30))
            assert 0.6 < np.std(rms) / np.median(sigma) < 1.4
        else:
            assert np.sqrt(np.mean(rms**2)) < 3 * np.median(sigma) < 0.3 * NOISE


def test_a_gaussian_filter_passes_what_the_standard_says() -> None:
    """exp(-pi (alpha cutoff / wave)^2) of a wave along x, away from the borders; a constant stays one."""
    alpha = np.sqrt(np.log(2) / np.pi)
    for wave in (20.0, WAVE, 80.0):
        z = np.sin(2 * np.pi * X / wave)
        fit = fit_form(height_map(z), "piston")
        share = np.exp(-np.pi * (alpha * WAVE / wave) ** 2)
        inner = np.s_[20:-20, 25:-25]
        expected = share * z + fit.residual - z
        low, high = (gaussian_filter(fit, WAVE, kept).residual for kept in ("low", "high"))  # type: ignore[arg-type]
        np.testing.assert_allclose(low[inner], expected[inner], atol=4e-3)
        np.testing.assert_allclose((low + high)[inner], fit.residual[inner], atol=1e-12)
    constant = gaussian_filter(replace(fit, residual=5.0 + 0 * X), WAVE, "low").residual
    np.testing.assert_allclose(constant, 5.0, atol=1e-9)
    with pytest.raises(InputError, match="cutoff is 4 mm, must be 8 to "):
        gaussian_filter(fit, 4.0, "low")


def test_an_aperture_holds_the_pixels_of_its_area() -> None:
    good = np.ones(X.shape, np.bool_)
    for text, area in (
        ("circle", np.pi * MIDDLE[1] ** 2),
        ("circle:radius=20,x=60,y=50", np.pi * 400),
        ("ellipse:a=40,b=25", np.pi * 1000),
        ("rectangle:width=61,height=31", 61 * 31),
    ):
        found = aperture_mask([text], X, Y, good)
        assert found.sum() * PITCH**2 == pytest.approx(area, rel=0.03), text
        fit = fit_form(height_map(1e-3 * X), "tilt", aperture=found)
        np.testing.assert_array_equal(np.isfinite(fit.residual), found)
    both = aperture_mask(["circle", "rectangle:width=61,height=200"], X, Y, good)
    assert both.sum() < aperture_mask(["circle"], X, Y, good).sum()


def test_pvr_is_that_of_smooth_terms_and_three_sigma() -> None:
    u, v = np.random.default_rng(2).uniform(-1, 1, (2, 60_000))
    u, v = (part[np.hypot(u, v) < 1] for part in (u, v))
    smooth = 2e-4 * zernike(3, 1, np.hypot(u, v), np.arctan2(v, u))
    noise = 3e-5 * np.random.default_rng(3).standard_normal(len(u))
    found = pvr(50 * u, 50 * v, smooth + noise)
    assert found == pytest.approx(np.ptp(smooth) + 3 * 3e-5, rel=0.02)
    assert np.ptp(smooth + noise) > found
    assert np.isnan(pvr(u[:60], v[:60], smooth[:60]))


PRYSM = """
import importlib.metadata, json, sys, types
module = types.ModuleType("pkg_resources")
module.get_distribution = importlib.metadata.distribution
sys.modules["pkg_resources"] = module
import numpy as np
from prysm.polynomials.zernike import nm_to_ansi_j, nm_to_fringe, nm_to_name, zernike_nm
pairs = [(n, m) for n in range(6) for m in range(-n, n + 1, 2)]
at = np.array([0.7, 0.2, 0.9]), np.array([0.4, 2.5, 5.1])
rows = [[n, m, nm_to_ansi_j(n, m), nm_to_fringe(n, m), nm_to_name(n, m),
         zernike_nm(n, m, *at).tolist(), zernike_nm(n, m, *at, norm=False).tolist()] for n, m in pairs]
json.dump(rows, sys.stdout)
"""


def test_indices_names_and_norms_are_prysms() -> None:
    pytest.importorskip("importlib.metadata").version("prysm")
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", PRYSM], check=True, capture_output=True)
    rho, theta = np.array([0.7, 0.2, 0.9]), np.array([0.4, 2.5, 5.1])
    odd = set()
    for n, m, ansi, fringe, name, rms, amplitude in json.loads(done.stdout):
        assert (ansi_index(n, m), fringe_index(n, m)) == (ansi, fringe), (n, m)
        np.testing.assert_allclose(zernike(n, m, rho, theta), rms, atol=1e-12)
        disc = height_map(zernike(n, m, np.hypot(X - MIDDLE[0], Y - MIDDLE[1]) / MIDDLE[1],
                                  np.arctan2(Y - MIDDLE[1], X - MIDDLE[0])))  # fmt: skip
        if n == 3:
            listed = fit_zernike(disc, 3, radius=MIDDLE[1]).listed("fringe", amplitude=True)
            own = dict(zip(listed.names, listed.values, strict=True))[f"Z{fringe} {name}"]
            assert own == pytest.approx(rms[0] / amplitude[0], rel=1e-9)
        odd |= {(n, m)} if zernike_name(n, m) != name else set()
    assert odd <= {(5, 5), (5, -5)}  # prysm calls the first pentafoil the secondary one


def test_turns_separate_the_mirror_from_the_rig() -> None:
    """A mirror with coma and a bump, a rig with astigmatism and a bump, over all of a circle but its rim."""

    def mirror(u: Floats, v: Floats) -> Floats:
        bump = np.exp(-((u - 20) ** 2 + (v + 10) ** 2) / 200)
        return np.asarray(1e-3 * bump + 4e-4 * zernike(3, 1, np.hypot(u, v) / 60, np.arctan2(v, u)))

    def rig(u: Floats, v: Floats) -> Floats:
        return np.asarray(5e-4 * np.exp(-((u + 15) ** 2 + (v - 5) ** 2) / 300) + 2e-7 * (u * u - v * v))

    u, v = X - MIDDLE[0], Y - MIDDLE[1]
    inside = np.hypot(u, v) <= 58
    for degrees in ([0, 90, 180, 270], [0, 89.9, 180.1, 270.05], [0, 60, 200]):
        turns = np.radians(degrees)
        fits = []
        for angle in turns:
            c, s = np.cos(angle), np.sin(angle)
            z = rig(u, v) + mirror(c * u + s * v, c * v - s * u)
            fits.append(fit_form(height_map(z), "piston", aperture=inside))
        found = compare_runs(fits, list(turns))
        known = np.isfinite(found.mirror)
        assert np.hypot(found.x, found.y)[~known].min() > 58 - 1.5 * PITCH
        assert np.nanstd(found.left) < 5e-6
        assert np.nanmax(np.abs(found.left)) < 5e-5  # at the rim
        symmetric = mirror(found.x, found.y) - found.mirror  # the rig's part that no turn changes
        error = symmetric - np.nanmean(symmetric)
        assert np.nanstd(error) < 0.35 * np.nanstd(rig(found.x, found.y))
        both = found.mirror + found.rig - mirror(found.x, found.y) - rig(found.x, found.y)
        assert np.nanstd(both) < 5e-6
    plain = compare_runs([fits[0], fits[0]])
    assert plain.rms(plain.mirror) == pytest.approx(fits[0].rms, rel=0.05)
    assert np.nanmax(np.abs(plain.left)) < 1e-12
    with pytest.raises(InputError, match="3 angles, must be 2"):
        compare_runs(fits[:2], [0, 1, 2])


def test_a_limit_is_met_beyond_its_uncertainty() -> None:
    figures = {"rms": (40e-6, 2e-6), "slope": (21e-6, np.nan)}
    for text, verdict in (
        ("rms=50nm", "pass"), ("rms=42nm", "undecided"), ("rms=0.03um", "fail"), ("rms=1nm", "fail"),
        ("slope=20urad", "undecided"), ("slope=1mrad", "undecided"),
    ):  # fmt: skip
        assert judge(text, figures).verdict == verdict, text
