"""The adjustment against scene.trace: model, derivatives, convergence, truth of the covariance, warnings."""

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest

from lab.calibration.rigs import Rig, correspondence_of, open_air, prism, shape_surface
from optolever import InputError
from optolever.calibration import (
    Ball,
    Calibration,
    Flat,
    Observation,
    Plate,
    Rest,
    Target,
    calibrate,
    default_priors,
    left_out,
    unused_accuracy,
)
from optolever.calibration.adjust import adjust, rays_of, reflected
from optolever.scene import TYPED, Accuracy, Covariance, load, parameter_changes, parameter_values, trace


def air(seed: int, poses: int, tilts: tuple[float, float] = (3.0, 8.0), noise: float = 0.0016) -> Rig:
    rng = np.random.default_rng(seed)
    return open_air(rng, poses, correspondence_of(noise, rng), tilts, size=100)


def prisms(seed: int, balls: int, pinhole: bool = False) -> Rig:
    rng = np.random.default_rng(seed)
    return prism(rng, balls, correspondence_of(0.005, rng), pinhole)


def deviations(found: Calibration, rig: Rig) -> float:
    """chi2 per rank of the scene's covariance: of what would make the calibrated scene the true one."""
    covariance = found.scene.covariance
    assert covariance is not None
    own, changes = parameter_values(found.scene), parameter_changes(found.scene, rig.truth)
    some = np.array([name in changes for name in covariance.names])  # the truth's mirror has no form
    miss = np.array([changes[name] - own[name] for name in np.array(covariance.names)[some]])
    matrix = covariance.matrix[np.ix_(some, some)]
    sigma = np.sqrt(np.diag(matrix))
    variances, directions = np.linalg.eigh(matrix / np.outer(sigma, sigma))
    known = variances > 1e-12  # the gauge leaves fewer directions than numbers
    share = (directions.T @ (miss / sigma))[known] / np.sqrt(variances[known])
    return float(np.mean(share**2))


@pytest.mark.parametrize("pinhole", [False, True])
@pytest.mark.parametrize(
    ("target", "values"),
    [
        (Plate(), {"a.height": 0.4, "a.tilt_x": 0.01, "a.tilt_y": -0.02}),
        (Rest(3), {f"rest.L{i}{n - i}": 0.01 * (i - 0.7) * n for n in (2, 3) for i in range(n + 1)}),
        (Ball(30.0, 0.01), {"a.x": 1.0, "a.y": -2.0, "a.depth": 0.3, "a.radius": 0.02}),
        (Flat(1e-3), {"a.height": 0.4, "a.tilt_x": 0.01, "a.tilt_y": -0.02, "flatness_1um.L20": 0.003,
                      "flatness_1um.L11": 0.002, "flatness_1um.L02": -0.001}),
    ],
)  # fmt: skip
def test_the_model_is_what_the_ray_tracer_sees(
    pinhole: bool, target: Target, values: dict[str, float]
) -> None:
    truth = prisms(0, 0, pinhole).truth if not isinstance(target, Flat) else air(0, 1).truth
    shape = target.shape("a", values, truth.mirror)
    seen = trace(truth, shape_surface(_written_out(target, values, truth.mirror)))
    on = seen.visible
    if isinstance(target, Ball):
        on &= np.hypot(seen.x - 31.0, seen.y - 20.5) < 2.5
    row, col = np.nonzero(on)
    point, out = reflected(rays_of(truth, row.astype(float), col.astype(float)), shape)
    u, v, _ = truth.pattern.landing(point, out)
    assert on.sum() > 100
    assert np.abs(u - seen.u[on]).max() < 1e-9
    assert np.abs(v - seen.v[on]).max() < 1e-9
    assert np.abs(point[2] - seen.z[on]).max() < 1e-10


def _written_out(target, values, mirror):  # type: ignore[no-untyped-def]
    """The targets' heights from their definitions, slopes by the complex step of shape_surface."""
    legendre = [lambda s: 1.0, lambda s: s, lambda s: 1.5 * s * s - 0.5, lambda s: 2.5 * s**3 - 1.5 * s]

    def height(x, y):  # type: ignore[no-untyped-def]
        s, t = 2 * x / mirror.length - 1, 2 * y / mirror.width - 1
        if isinstance(target, Ball):
            square = (x - mirror.length / 2 - 1.0) ** 2 + (y - mirror.width / 2 + 2.0) ** 2
            near = np.real(square) < 9.0
            return np.where(near, 0.3 - 30.02 + np.sqrt(30.02**2 - np.where(near, square, 0)), 0.15 + 0 * x)
        z = values.get("a.height", 0.0) + values.get("a.tilt_x", 0.0) * (x - mirror.length / 2)
        z = z + values.get("a.tilt_y", 0.0) * (y - mirror.width / 2)
        for name, c in values.items():
            if ".L" in name:
                z = z + c * legendre[int(name[-2])](s) * legendre[int(name[-1])](t)
        return z

    return height


@pytest.mark.parametrize("poses", [3, pytest.param(5, marks=pytest.mark.slow)])
def test_open_air_without_a_guess(poses: int) -> None:
    rig = air(poses, poses)
    far = replace(rig.given, pattern=replace(rig.given.pattern, origin=np.array([300.0, 0.0, 700.0])))
    found = calibrate(far, rig.observations)
    assert not found.guessed
    assert 0.9 < found.adjustment.chi < 1.1
    assert "The captures do not determine" not in warned(found)
    assert "the reference's flatness" in warned(found)
    sigma = {each["name"]: each["sigma"] for each in found.parameters}
    truth = parameter_values(rig.truth)
    for name in [
        "camera.f",
        "camera.cx",
        "camera.cy",
        "camera.k1",
        "pattern.b20",
        "pattern.b11",
        "pattern.b02",
    ]:
        value = parameter_values(found.scene)[name]
        assert abs(value - truth[name]) < 5 * sigma[name], name
    assert all(0.8 < left_out(found, f"flat{k}") < 1.5 for k in range(1, poses))


@pytest.mark.slow  # 10 adjustments; every day: one of a prism, the numbers of open air
def test_covariance_is_true() -> None:
    """(estimate - truth)^T C^-1 (estimate - truth) per number, mean over draws."""
    misses = []
    for seed in range(6):
        rig = air(seed, 3)
        misses.append(deviations(calibrate(rig.truth, rig.observations, guess=True), rig))
    assert 0.75 < np.mean(misses) < 1.3
    misses = []
    for seed in range(4):
        rig = prisms(seed, 3)
        misses.append(deviations(calibrate(rig.given, rig.observations), rig))
    assert 0.75 < np.mean(misses) < 1.3


@pytest.mark.slow  # every start of the adjustment is tried
def test_rest_alone_ends_in_the_least_minimum() -> None:
    """This rig has a second minimum, 100 in chi2 above the truth's numbers, that chi (1.01) does not show."""
    rng = np.random.default_rng([0, 5])
    rig = prism(rng, 0, correspondence_of(0.005, rng))
    found = calibrate(rig.given, rig.observations).adjustment
    names = found.problem.names
    at_truth = found.problem.residuals(np.array([rig.numbers.get(name, 0.0) for name in names]))
    assert found.cost < at_truth @ at_truth


@pytest.mark.slow
def test_a_held_lens_has_a_notice_and_a_free_one_is_found() -> None:
    """The same rig with the lens held at its typed values, and with the default priors."""
    rng = np.random.default_rng(4)
    rig = prism(rng, 1, correspondence_of(0.005, rng), pinhole=True, size=160, lens=True)
    lens = {f"camera.{key}": 0.0 for key in ("k1", "k2", "p1", "p2", "cx", "cy")}
    held, free = (calibrate(rig.given, rig.observations, priors) for priors in (lens, None))
    assert free.implausible == []
    assert 0.9 < free.adjustment.chi < 1.1
    (k1,) = (each for each in free.parameters if each["name"] == "camera.k1")
    assert abs(k1["value"] - rig.numbers["camera.k1"]) < 3 * k1["sigma"] < 0.01
    assert any("does not fit rest; residuals over noise" in notice.name for notice in held.notices)
    assert not any("does not fit rest; residuals over noise" in notice.name for notice in free.notices)


def with_field(each: Observation, amplitude: float) -> Observation:
    """A capture through static schlieren: rms `amplitude` cells, the same in every capture."""
    c = each.correspondence
    row, col = (np.linspace(0, 1, n)[at] for n, at in zip(c.u.shape, np.indices(c.u.shape), strict=True))
    waves = [(3.1, -2.2, 0.4), (-1.9, 4.0, 2.0), (4.4, 1.3, 5.1)]
    u, v = (sum(np.cos(a * row + b * col + shift * p) for a, b, p in waves) for shift in (1.0, 2.0))
    u, v = (amplitude * part / np.sqrt(np.mean(np.square(part))) for part in (u, v))
    return replace(each, correspondence=replace(c, u=c.u + u, v=c.v + v))


@pytest.mark.slow  # half a minute: the rest capture is weighted anew
def test_a_rig_calibrated_through_schlieren() -> None:
    """0.3 pixels of the display, 15 times the noise: no number leaves its prior, the rest is reported."""
    rng = np.random.default_rng(2)
    rig = prism(rng, 3, correspondence_of(0.005, rng))
    seen = [with_field(each, 0.075) for each in rig.observations]
    found = calibrate(rig.given, seen)
    assert found.implausible == []
    assert found.adjustment.chis["rest"] > 3
    assert all(found.adjustment.chis[f"ball{k}"] < 1.3 for k in range(3))
    assert "bent display" in warned(found)


def warned(found: Calibration) -> str:
    return "\n".join(str(notice) for notice in found.notices)


@pytest.mark.slow  # minutes: every start of the adjustment is tried
def test_what_cannot_be_observed_is_warned_of() -> None:
    small = air(3, 3, (0.9, 1.0))
    assert "parallel within" in warned(calibrate(small.truth, small.observations, guess=True))
    one = air(3, 1)
    text = warned(calibrate(one.truth, one.observations, guess=True))
    assert "1 poses without a ball" in text
    assert "The captures do not determine" in text
    rest = prisms(1, 0)
    text = warned(calibrate(rest.given, rest.observations))
    assert "rest without a ball" in text
    assert "The captures do not determine" in text


def bad(name: str) -> object:
    """A calibration of three flats, one thing of which is wrong."""
    rig = air(6, 3)
    first, *others = rig.observations
    c = first.correspondence
    cut = {key: getattr(c, key)[:-1] for key in ("u", "v", "sigma_u", "sigma_v", "flags")}
    dark = replace(c, flags=np.ones_like(c.flags))
    seen = {
        "size": [replace(first, correspondence=type(c)(**cut)), *others],
        "mirror": [replace(first, correspondence=dark), *others],
        "twice": [first, *others, replace(others[0], name="again")],
        "frame": [replace(each, target=Plate()) for each in rig.observations],
    }
    priors = {"negative": {"camera.f": -1.0}, "gauge": {"camera.x": 1.0}}
    return calibrate(rig.given, seen.get(name, rig.observations), priors.get(name))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (partial(bad, "size"), "pixels"),
        (partial(bad, "mirror"), "mirror in view"),
        (partial(bad, "twice"), "same pose twice"),
        (partial(bad, "frame"), "z = 0"),
        (partial(bad, "negative"), "at least 0"),
        (partial(bad, "gauge"), "must be 0; z = 0 is"),
        (partial(Ball, 0.0, 1.0), "must be"),
        (partial(Rest, 0), "must be"),
        (partial(Covariance, ("a", "b"), np.array([[1.0, 2.0], [2.0, 1.0]])), "not positive"),
        (partial(Covariance, ("a", "b"), np.full((2, 2), np.nan)), "finite"),
        (partial(Covariance, ("a", "a"), np.eye(2)), "names a twice"),
    ],
)
def test_a_mistake_is_one_line(make: Callable[[], object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


@pytest.mark.slow  # half a minute: the adjustment does not converge
def test_a_ball_that_is_none() -> None:
    rig = prisms(7, 1)
    rest, ball = rig.observations
    wrong = [rest, replace(ball, target=Ball(200.0, 0.01))]
    found = calibrate(rig.given, wrong)
    assert found.implausible
    assert "a capture mislabelled" in warned(found)


@pytest.mark.parametrize("field", [each.name for each in fields(Accuracy)])
@pytest.mark.parametrize("preset", ["monitor-mirror", "prism48"])
def test_a_stated_accuracy_is_a_prior_or_named(preset: str, field: str) -> None:
    scene = load(preset)
    stated = replace(scene, accuracy=replace(TYPED, **{field: 0.5 * (getattr(TYPED, field) or TYPED.scale)}))
    before, after, named = default_priors(scene), default_priors(stated), unused_accuracy(stated)
    assert (before != after) != bool(named)
    assert all(f"{field} of [accuracy]" in line for line in named)
    assert not unused_accuracy(scene)


@pytest.mark.parametrize(("narrow", "told"), [pytest.param(1.0, 0, marks=pytest.mark.slow), (4.0, 1)])
def test_priors_that_the_captures_contradict_are_told(narrow: float, told: int) -> None:
    rig = prisms(7, 0)
    priors = {name: sigma / narrow for name, sigma in default_priors(rig.given).items()}
    found = calibrate(rig.given, rig.observations, priors)
    notices = found.notices
    assert sum("further off than assumed; the worst is " in str(each) for each in notices) == told
    priors = {each["name"]: each for each in found.parameters}
    far = {
        name for name, each in priors.items() if abs(each["value"] - each["prior"]) > 3 * each["prior_sigma"]
    }
    assert far == {str(each).split()[0] for each in notices if "by the captures, typed" in str(each)}


def test_sources_are_what_their_errors_do_to_the_numbers(ball_rig: Calibration) -> None:
    """The ball's: adjusted anew with its radius off by a tenth of its sigma, both ways; the frames': by the
    data's rows."""
    solved, known = ball_rig.adjustment, ball_rig.scene.covariance
    problem, chi = solved.problem, max(1.0, solved.chi)
    assert known is not None
    assert known.parts is not None
    parts = dict(zip(known.sources, known.parts, strict=True))
    by = ball_rig.by
    sigma = np.sqrt(np.diag(known.matrix))
    scale = np.outer(sigma, sigma)
    off = 0.1 * problem.sigmas["ball0.radius"]
    ahead, behind = (
        adjust(replace(problem, means={**problem.means, "ball0.radius": each}), problem.named(solved.values))
        for each in (off, -off)
    )
    change = chi * by @ (ahead.values - behind.values) / 0.2
    ball = parts["the radius of the ball"]
    assert np.abs((ball - np.outer(change, change)) / scale).max() < 0.02 * np.abs(ball / scale).max()
    gain = solved.covariance @ solved.jacobian[: -len(problem.names)].T / chi
    noise = by @ gain @ gain.T @ by.T
    assert np.abs((parts["noise of the calibration's captures"] - noise) / scale).max() < 1e-6


@pytest.fixture(scope="module")
def ball_rig() -> Calibration:
    rng = np.random.default_rng(8)
    rig = prism(rng, 1, correspondence_of(0.005, rng), size=160)
    return calibrate(rig.given, rig.observations)
