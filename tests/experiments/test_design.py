"""Design, sensor maps and adaptive sensing on small scenes: against Monte Carlo, formulas and the truth."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from optolever.decode import decode
from optolever.errors import InputError
from optolever.experiments.design import (
    Candidate,
    Goal,
    Lever,
    Place,
    VirtualOnDemand,
    adapt,
    best_fixed,
    candidates,
    ladder,
    merit,
    offers,
    predict,
    run_design,
    sensor_maps,
    share_within,
    simulate,
    starting,
    user_candidate,
    varied,
)
from optolever.experiments.design.fixed_search import fringe_codes
from optolever.experiments.design.prediction import predict_axis
from optolever.patterns import Sequence, sequence, sequence_from_text
from optolever.projector import capture
from optolever.scene import Scene, dent, load, resize


@pytest.fixture(scope="module")
def prism() -> Scene:
    return resize(load("prism48"), 72, 96)


@pytest.fixture(scope="module")
def lever(prism: Scene) -> Lever:
    return Lever(prism, dent("gaussian", prism, peak=0.3, sigma=8))


@pytest.mark.parametrize(
    "text",
    [
        "gray+phase:period=8",
        "phase:steps=3,periods=101/4",
        "phase:steps=6,periods=10.2/9.7",
        "ladder",
        "stripe:step=32",
    ],
)
def test_predicted_height_error_within_15_percent_of_simulation(lever: Lever, text: str) -> None:
    """Four draws of noise; 15 %, the figure that is promised."""
    rows, cols = lever.scene.pattern.rows, lever.scene.pattern.cols
    shown = ladder(rows, cols, 6.0, 3, 5) if text == "ladder" else sequence_from_text(text, rows, cols)
    there = predict(lever.view, shown, 1.0)
    found, share = simulate(lever, Candidate(text, shown), 1.0, range(4), "numpy")
    assert lever.height(there).total == pytest.approx(found, rel=0.15)
    assert share == pytest.approx(there.measured_share, abs=0.01)


@pytest.mark.parametrize("fine", [4.0, 5.0, 8.0])
def test_predicted_where_cells_are_coarse_and_the_map_bends(fine: float) -> None:
    """A ball's rim seen in cells of 1.4 pixels at a blur of 0.4: stairs count as noise, creases as loss."""
    scene = resize(varied(load("paper-simulation"), "pattern", 0.7), 96, 96)
    scene = replace(scene, pattern=replace(scene.pattern, blur_px=0.4))
    coarse = Lever(scene, dent("ball", scene, peak=0.4))
    shown = ladder(scene.pattern.rows, scene.pattern.cols, fine, 2, 5)
    there = coarse.height(predict(coarse.view, shown, 1.0))
    found, share = simulate(coarse, Candidate("", shown), 1.0, range(4), "numpy")
    assert there.total == pytest.approx(found, rel=0.15)
    assert there.share == pytest.approx(share, abs=0.006)


@pytest.mark.parametrize(
    ("text", "blur", "noise"),
    [
        # total reflection dims pixels near the border, and something nearer to it is bright
        ("phase:steps=8,periods=29.325/27.0692", 1.4, 0.78),
        ("gray+phase:period=10,steps=9", 1.4, 0.78),
        # pixels at the border are a tenth wider than those beside them
        ("phase:steps=9,periods=8.7975/8.58293", 1.1, 0.43),
        # the decoder knows the noise of few stripes badly
        ("stripe:step=32", 1.4, 0.78),
    ],
)
def test_predicted_beside_a_clamped_edge(text: str, blur: float, noise: float) -> None:
    """Where the mirror bends beside its anchor, what the solver extrapolates adds to the border's shift."""
    scene = resize(load("paper-prototype"), 172, 108)
    scene = replace(scene, pattern=replace(scene.pattern, blur_px=blur))
    clamped = Lever(scene, dent("ball", scene, peak=0.07, radius=1000), stride=1)
    shown = sequence_from_text(text, scene.pattern.rows, scene.pattern.cols)
    there = clamped.height(predict(clamped.view, shown, noise))
    found, share = simulate(clamped, Candidate(text, shown), noise, range(2), "numpy")
    assert there.total == pytest.approx(found, rel=0.15)
    assert there.share == pytest.approx(share, abs=0.006)


@pytest.mark.parametrize("periods", [(60.5, 21.9, 7.93), (9.18, 8.16)])
def test_the_border_in_a_strong_blur_as_it_is_decoded(periods: tuple[float, ...]) -> None:
    """What several periods make of a border that blur spreads over four cells, pixel by pixel."""
    scene = resize(load("paper-simulation"), 72, 72)
    scene = replace(scene, pattern=replace(scene.pattern, blur_px=2.0))
    view = Lever(scene, dent("flat", scene), stride=1).full
    shown = sequence("phase", scene.pattern.rows, scene.pattern.cols, steps=8, periods=list(periods))
    there = predict_axis(view, shown, 0.5, "v")
    errors, sigmas, flags = [], [], []
    for seed in range(12):
        seen = capture(scene, dent("flat", scene), shown, noise=0.5, seed=seed, renderer="numpy")
        found = decode(seen.frames, shown)
        errors.append(found.v - view.truth.v)
        sigmas.append(found.sigma_v)
        flags.append(found.flags != 0)
    middle = slice(20, 52)
    mean, spread, sigma = np.mean(errors, axis=0), np.std(errors, axis=0, ddof=1), np.mean(sigmas, axis=0)
    for row in (1, 2, 3, 4, 68, 69, 70):  # of the camera, 0.5 to 4.5 cells from the border
        lost = np.mean(flags, axis=0)[row, middle]
        if lost.max() > 0.0 or there.refused[row, middle].max() > 0.01:
            assert lost.mean() == pytest.approx(there.refused[row, middle].mean(), abs=0.2)
            continue
        assert mean[row, middle].mean() == pytest.approx(there.bias[row, middle].mean(), abs=0.004)
        assert rms(spread[row, middle]) == pytest.approx(rms(there.noise[row, middle]), rel=0.1)
        assert sigma[row, middle].mean() == pytest.approx(there.stated[row, middle].mean(), rel=0.15)


def test_what_an_unknown_blur_makes_of_the_border() -> None:
    """Two like periods do not tell the blur: pixels that are dimmer than those around are refused."""
    scene = resize(load("paper-simulation"), 72, 72)
    scene = replace(scene, pattern=replace(scene.pattern, blur_px=1.0))
    flat = dent("flat", scene)
    shown = sequence("phase", scene.pattern.rows, scene.pattern.cols, steps=4, periods=(29.325, 27.0692))
    there = predict(Lever(scene, flat, stride=1).full, shown, 1.0)
    good = np.mean(
        [
            decode(capture(scene, flat, shown, noise=1.0, seed=seed, renderer="numpy").frames, shown).good
            for seed in range(6)
        ],
        axis=0,
    )
    lost = 1 - (1 - there.u.refused) * (1 - there.v.refused)
    for row in range(6):
        assert 1 - good[row, 10:62].mean() == pytest.approx(lost[row, 10:62].mean(), abs=0.1)
    assert lost[1, 10:62].mean() > 0.5


def rms(values: np.ndarray) -> float:
    return math.sqrt(float(np.mean(values**2)))


def test_merit_counts_lost_pixels_as_five_times_the_rms() -> None:
    """Against the mean square over 1000 pixels, some of them replaced by five times the rms of the rest."""
    errors = np.full(1000, 2e-3)
    errors[:30] *= 5
    assert merit(2e-3, 0.97) == pytest.approx(math.sqrt(np.mean(errors**2)))
    assert merit(2e-3, 1.0) == pytest.approx(2e-3)
    assert merit(math.nan, 1.0) == math.inf


def test_a_thinned_camera_predicts_the_full_one() -> None:
    """Every third pixel, and the logarithm: the same height error within 10 %."""
    scene = resize(load("prism48"), 144, 192)
    surface = dent("gaussian", scene, peak=0.3, sigma=8)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    sizes = []
    for stride in (1, 3):
        lever = Lever(scene, surface, stride=stride)
        sizes.append(lever.height(predict(lever.view, shown, 1.0)).total)
    assert sizes[1] == pytest.approx(sizes[0], rel=0.1)


def test_a_thinned_camera_predicts_errors_next_to_the_patterns_edge() -> None:
    """paper-simulation reaches it, where errors grow without limit: every fourth pixel within 10 %."""
    scene = resize(load("paper-simulation"), 192, 192)
    surface = dent("gaussian", scene, peak=0.6, sigma=25)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    sizes = []
    for stride in (1, 4):
        lever = Lever(scene, surface, stride=stride)
        sizes.append(lever.height(predict(lever.view, shown, 1.0)).noise)
    assert sizes[1] == pytest.approx(sizes[0], rel=0.1)


def test_candidates_fit_the_budget() -> None:
    found = candidates(72, 96, 20)
    assert len(found) > 20
    assert max(len(candidate.sequence) for candidate in found) <= 20
    assert len({candidate.text for candidate in found}) == len(found)


def test_the_choice_goes_through_a_file(prism: Scene, tmp_path: Path) -> None:
    """What wins is what a capture can show, and beats the default sequence at as many frames."""
    design = run_design(prism, frames=14, verify=1, seeds=1, renderer="numpy")
    assert design.chosen is not None
    best = design.rows[0]
    assert best.text == design.chosen.text
    assert best.simulated == pytest.approx(best.predicted, rel=0.3)
    design.chosen.sequence.save(tmp_path / "best.toml")
    again = sequence_from_text(str(tmp_path / "best.toml"), prism.pattern.rows, prism.pattern.cols)
    assert again == design.chosen.sequence
    with pytest.raises(InputError, match="the surface has 8x8"):
        sequence_from_text(str(tmp_path / "best.toml"), 8, 8)


def test_a_users_module_in_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A console script's path does not hold it."""
    (tmp_path / "nearby.py").write_text(
        "from optolever.patterns import sequence\n"
        "def waves(rows, cols):\n    return sequence('phase', rows, cols)\n"
    )
    monkeypatch.setattr(sys, "path", [part for part in sys.path if part])
    monkeypatch.chdir(tmp_path)
    assert user_candidate("nearby:waves", 40, 60).sequence == sequence("phase", 40, 60)
    sys.modules.pop("nearby")


def test_user_patterns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A callable, a folder that Sequence wrote, a folder of bare images: all candidates like any other."""
    (tmp_path / "mine.py").write_text(
        "from optolever.patterns import sequence\n"
        "def good(rows, cols):\n    return sequence('phase', rows, cols)\n"
        "def bad(rows, cols):\n    return 7\n"
        "def broken(rows, cols):\n    raise ValueError('no')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert user_candidate("mine:good", 40, 60).sequence == sequence("phase", 40, 60)
    for name, complaint in (
        ("bad", "must be a Sequence"),
        ("broken", "ValueError: no"),
        ("none", "imported"),
    ):
        with pytest.raises(InputError, match=complaint):
            user_candidate(f"mine:{name}", 40, 60)
    sys.modules.pop("mine")
    shown = sequence("phase", 40, 60, periods=16.0)
    shown.save_png(tmp_path / "described")
    assert user_candidate(str(tmp_path / "described"), 40, 60).sequence == shown
    bare = tmp_path / "bare"
    bare.mkdir()
    lines = []
    for index, frame in enumerate(shown.frames):
        cv2.imwrite(str(bare / f"{index}.png"), shown.render_frame(index))
        lines.append(f'[[frames]]\nfile = "{index}.png"\naxis = "{frame.axis}"\n')
    (bare / "coordinates.toml").write_text("\n".join(lines))
    found = user_candidate(str(bare), 40, 60).sequence
    assert np.array_equal(found.render(), shown.render())
    cv2.imwrite(str(bare / "0.png"), shown.render_frame(0).T.copy()[:40, :40])
    with pytest.raises(InputError, match=r"0\.png: is 40x40 pixels, the pattern has 40x60"):
        user_candidate(str(bare), 40, 60)


def test_free_levels_are_ranked_like_the_fringes_they_show(lever: Lever) -> None:
    """The same images, once as fringes, once as free levels: the same noise."""
    pattern = lever.scene.pattern
    shown = sequence("phase", pattern.rows, pattern.cols, steps=6, periods=(10.2, 9.7))
    frames = tuple(
        type(frame)("levels", frame.axis, levels=tuple(int(v) for v in frame.tables(*shown.shape[1:])[k]))
        for frame in shown.frames
        for k in ("uv".index(frame.axis or "u"),)
    )
    fringes = predict(lever.view, shown, 1.0)
    free = predict(lever.view, Sequence(frames, pattern.rows, pattern.cols), 1.0)
    inner = fringes.usable
    assert np.median(free.u.noise[inner]) == pytest.approx(np.median(fringes.u.noise[inner]), rel=0.1)


def test_slope_limits_of_the_45_degree_prism() -> None:
    """From -atan((L0 - x) / x) / 2, the apex, to 22.5 degrees, along the mirror; free mode h = C x."""
    scene = resize(load("paper-simulation"), 64, 64)
    maps = sensor_maps(scene)
    on = np.isfinite(maps.low)
    end = scene.pattern.point(scene.pattern.cols - 0.5, 0.0)  # up to a cell beyond the apex
    low = 0.5 * (np.arctan((maps.x - end[0]) / end[2]) - math.radians(45))
    assert maps.low[on] == pytest.approx(low[on], abs=1e-9)
    apex = -np.arctan((scene.mirror.length - maps.x) / maps.x) / 2
    half = 0.5 * scene.mirror.length
    assert 0.5 * (np.arctan((maps.x - half) / half) - math.radians(45)) == pytest.approx(apex, abs=1e-12)
    assert np.degrees(maps.high[on]) == pytest.approx(22.5, abs=1e-6)
    known = np.isfinite(maps.free_mode)
    slope = maps.free_mode[known] / maps.x[known]
    assert np.ptp(slope) < 1e-5 * slope.mean()
    # flat mirror at 45 degrees: path x, and the image folds at a curvature of cos(45 deg) / (2 s)
    assert maps.path[on] == pytest.approx(maps.x[on] / math.sqrt(2), rel=1e-9)
    # a slope turns the ray, which meets the pattern squarely, by twice itself
    lever = 2e-3 * maps.path[on] / scene.pattern.pitch
    assert maps.lever[on] == pytest.approx(lever, rel=1e-6)


@pytest.mark.parametrize(("angle", "margin"), [(45, -0.17), (48, 2.83), (50, 4.83)])
def test_total_reflection_margin(prism: Scene, angle: float, margin: float) -> None:
    """Silicone of 1.41: lost by 0.17 degrees at 45, kept up to 2.8 at 48 and 4.8 at 50."""
    maps = sensor_maps(varied(prism, "angle", angle), side=24)
    assert maps.numbers()["reflection_margin_deg"] == pytest.approx(margin, abs=0.01)


def test_varied_scenes(prism: Scene) -> None:
    """Another resolution keeps the field; what cannot be is refused."""
    for name in ("camera", "pattern"):
        other = varied(prism, name, 2.0)
        ends = [scene.pattern.point(scene.pattern.cols - 0.5, -0.5) for scene in (prism, other)]
        assert ends[0] == pytest.approx(ends[1], abs=1e-9)
    assert varied(prism, "index", 1.5).medium.index == 1.5  # type: ignore[union-attr]
    with pytest.raises(InputError, match="angle asks for a prism"):
        varied(load("monitor-mirror"), "angle", 45.0)
    with pytest.raises(InputError, match="must be one of"):
        varied(prism, "colour", 1.0)


def test_share_within_is_the_gaussian_one() -> None:
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.5, 3.0, (200, 200))
    there = rng.random((200, 200)) > 0.1
    error = sigma * rng.normal(size=sigma.shape)
    found = (there & (np.abs(error) < 1.2)).mean()
    assert share_within(sigma, there, np.ones_like(there), 1.2) == pytest.approx(found, abs=0.01)


def test_adaptive_sensing_stops_when_the_goal_is_met() -> None:
    """A harder goal takes more frames; what it says of itself is what the truth says, mean of six draws.

    Pixels are two cells wide here: stairs that are left shift whole images and tilt the mirror.
    """
    scene = resize(load("paper-prototype"), 80, 50)
    surface = dent("gaussian", scene, peak=0.1, sigma=6)
    lever = Lever(scene, surface, stride=1)
    counts = []
    for height in (5e-4, 3e-4):
        goal = Goal(height, 0.9, 60)
        start, told, within = starting(scene, 1.0, goal), [], []
        for seed in range(6):
            source = VirtualOnDemand(scene, surface, noise=1.0, seed=seed, renderer="numpy")
            done = adapt(source, start, goal)
            assert done.met
            assert source.shown == len(done.sequence)
            error = np.where(done.height.good, np.abs(done.height.z - lever.full.truth.z), np.inf)
            within.append((error <= height)[lever.inner].mean())
            told.append(done.steps[-1].within)
        assert min(within) >= goal.share
        assert np.mean(within) == pytest.approx(np.mean(told), abs=0.015)
        counts.append(len(done.sequence))
    assert counts[1] > counts[0]


def test_adaptive_sensing_says_when_a_goal_cannot_be_met() -> None:
    scene = resize(load("paper-prototype"), 80, 50)
    source = VirtualOnDemand(scene, dent("flat", scene), noise=1.0, renderer="numpy")
    goal = Goal(1e-7, 0.95, 14)
    done = adapt(source, starting(scene, 1.0, goal), goal)
    assert not done.met
    assert done.why
    assert len(done.sequence) <= 14
    with pytest.raises(InputError, match="goal"):
        starting(scene, 1.0, Goal(0.0))


@pytest.fixture(scope="module")
def places() -> list[Place]:
    """Two dents before a small camera."""
    scene = resize(load("paper-prototype"), 80, 50)
    goal = Goal(2e-3, 0.95, 20)
    start = starting(scene, 1.0, goal)
    return [Place(start, text, goal, "numpy") for text in ("flat", "gaussian:peak=0.1,sigma=6")]


def test_shares_are_predicted_as_they_are_measured(places: list[Place]) -> None:
    """Mean of four draws."""
    pattern = places[0].scene.pattern
    shown = sequence_from_text("phase:steps=3,periods=90/12", pattern.rows, pattern.cols)
    for place in places:
        found = np.mean([place.fixed(shown, seed) for seed in range(4)])
        assert place.outlook.share(shown) == pytest.approx(found, abs=0.01)


def test_nothing_that_is_offered_was_pruned(places: list[Place]) -> None:
    """Of two fringe codes for each axis all pairs predicted one by one, against what the bounds leave."""
    outlooks, need = [place.outlook for place in places], 0.9
    pattern = places[0].scene.pattern
    codes = [fringe_codes(axis, n, 6) for axis, n in (("u", pattern.cols), ("v", pattern.rows))]
    shown = [Sequence((*u.frames, *v.frames), pattern.rows, pattern.cols) for u in codes[0] for v in codes[1]]
    least = {s.frames: min(outlook.share(s) for outlook in outlooks) for s in shown}
    offer = next(offer for offer in offers(outlooks, need, 12) if offer.frames == 12)
    best = max(least.values())
    assert best >= need
    assert offer.looked_at >= len(shown)
    assert offer.best[0][0] >= best - 1e-9


def test_the_fixed_sequence_meets_the_goal_everywhere(places: list[Place]) -> None:
    found = best_fixed(places, Goal(2e-3, 0.95, 20), 1)
    assert found.best is not None
    assert min(found.shares) >= 0.95
    assert found.simulated <= found.offered
    again = [place.fixed(found.best.sequence, 0) for place in places]
    assert again == found.shares
