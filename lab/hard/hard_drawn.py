"""Drawn hard cases, always the same for a number: rigs seen by rays through pixels' areas, up to the height,
and solved by scenes that are a little wrong; mirrors that bend inside of a pixel; mirrors to solve.

Scenes: exact correspondences of a rig get white noise, and the height is solved by the right scene, by one
whose camera is turned about any axis, and by one whose pattern has another pitch.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt, distance_transform_edt
from scipy.spatial.transform import Rotation

from optolever.decode import Correspondence, decode
from optolever.errors import InputError
from optolever.experiments.arrays import Floats
from optolever.experiments.place import exact, surface_of
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import AreaTrace, Lighting, area_frames, trace_area
from optolever.reconstruct import PixelAnchor, reconstruct
from optolever.scene import Scene, Sensor, Surface, Trace, dent, load, resize, trace

from .drawn import between, drawn_dent, together
from .found import Found, FrameVerdict, found_area, found_height
from .hard_case import Case
from .hard_reconstruct import HIDDEN, Problem, reconstructed
from .rigs import KINDS, Rig, draw_rig, drawn_sensor

AREA_SHARE, AREA_PIXELS = 1e-3, 3
"""Silent errors that one drawn scene may have: this share of its unflagged pixels, or so many pixels."""

_SCENES = ("paper-simulation", "paper-prototype", "prism48", "monitor-mirror")
_SIZES, _SOLVED, _CURVED = (100, 191), (48, 193), (160, 300)  # rows and columns of a camera: from, below
_SEED, _SEED_SOLVED, _SEED_CURVED = 1977, 2006, 4711
#: Scenes that are right or a little wrong.
SCENES = ("right scene", "camera 0.2 deg", "pitch 0.2 %")
_SIZE = 96, 112
_TURN, _PITCH = np.radians(0.2), 0.002
_REST = "a rest capture takes most of it away, and no sigma knows the rest"
#: Mirrors that bend inside of a pixel: what it reads is a mean; a Correspondence means the place that its
#: centre sees.
CURVED_CODES = "gray+phase", "phase", "micro-phase", "gray"
FORMS = "relief", "ripples", "ridge", "ball"
_NOISES = 0.3, 1.0, 2.0  # rms levels
_STEEPEST = np.radians(4.2)
_WAVE = 3.0  # pixels


def random_cases(count: int, first: int = 0) -> Iterator[Case]:
    """`count` cases, alternately of the decoder and of the solver; a number's case is always the same."""
    for number in range(first, first + count):
        yield rig_case(number) if number % 2 == 0 else _solving(number)


def drawn_size(rng: np.random.Generator, sizes: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of a camera, each from the first to below the second."""
    rows, cols = rng.integers(*sizes, 2)
    return int(rows), int(cols)


def seen_area(
    scene: Scene, surface: Surface, code: str, sensor: Sensor, seed: int, lighting: Lighting | None = None
) -> tuple[Correspondence, AreaTrace, Sequence]:
    """Frames of pixels' areas, decoded; where every pixel looked; what was shown."""
    shown = sequence_from_text(code, scene.pattern.rows, scene.pattern.cols)
    area = trace_area(scene, surface)
    return decode(area_frames(area, shown, sensor, lighting, seed=seed), shown), area, shown


def rig_case(number: int) -> Case:
    """The drawn case of a number, always the same."""
    kind, size, code, sensor = _drawn_case(number)
    what, make = (f"random {number}", f"{code} on {kind}"), partial(_decoded_rig, number)
    noise, dtype = round(sensor.noise, 2), "uint8" if sensor.bits == 8 else "uint16"
    return Case("decode", *what, size, make, noise, dtype, "", AREA_SHARE, AREA_PIXELS)


def rig_of(number: int) -> tuple[Rig, str, Sensor]:
    """The rig of a number, its sequence's text and its camera's sensor."""
    kind, size, code, sensor = _drawn_case(number)
    return draw_rig(np.random.default_rng([_SEED, number, 1]), kind, size), code, sensor


def _decoded_rig(number: int) -> Found:
    rig, code, sensor = rig_of(number)
    return found_area(*seen_area(rig.scene, rig.surface, code, sensor, number, rig.lighting))


def _drawn_case(number: int) -> tuple[str, tuple[int, int], str, Sensor]:
    """Kind of rig, camera's size, sequence, sensor."""
    rng = np.random.default_rng([_SEED, number, 0])
    size = drawn_size(rng, _SIZES)
    return str(rng.choice(KINDS)), size, _code(rng), drawn_sensor(rng)


def _code(rng: np.random.Generator) -> str:
    """gray+phase in two of five, the README's codes in two, one with parameters of its own else."""
    common = ("gray+phase", "phase", "phase:steps=3,periods=8.73782/8.05745/8", "micro-phase", "gray")
    if rng.random() < 0.8:
        return str(rng.choice(common, p=(0.5, 0.14, 0.14, 0.12, 0.1)))
    bits = ("gray", "binary", "xor-gray", "long-run-gray")
    steps = int(rng.integers(3, 9))
    period = between(rng, 8, 40)
    ratio = rng.uniform(1.02, 1.2, 2)
    periods = "/".join(f"{number:.3f}" for number in (period, period * ratio[0], period * ratio.prod()))
    inverses = str(bool(rng.random() < 0.5)).lower()
    return str(
        rng.choice(
            [
                f"{rng.choice(bits)}:inverses={inverses}",
                f"gray+phase:steps={steps},period={2 * round(period / 4)}",
                f"phase:steps={steps}",
                f"phase:steps={steps},periods={periods}",
                f"stripe:step={between(rng, 4, 16):.2f}",
            ]
        )
    )


def _solving(number: int) -> Case:
    rng = np.random.default_rng([_SEED_SOLVED, number])
    scene, size = str(rng.choice(_SCENES)), drawn_size(rng, _SOLVED)
    dents = [drawn_dent(rng) for _ in range(rng.integers(1, 5))]
    problem = Problem(
        f"random {number}",
        partial(together, dents),
        scene,
        HIDDEN[rng.integers(len(HIDDEN))] if rng.random() < 0.5 else None,
        between(rng, 1e-3, 0.05) if rng.random() < 0.25 else 0.0,
    )
    noise = between(rng, 0.003, 1.0) if rng.random() < 0.8 else 0.0
    dtype = str(rng.choice(["float64", "float32"]))
    hidden = "" if problem.hide is None else f", {problem.hide.__name__.strip('_')}"
    wrong = f", {100 * problem.outliers:.1f} % wrong" if problem.outliers else ""
    make = partial(reconstructed, problem, size, noise, dtype)
    subject = f"{scene}, {len(dents)} dents{hidden}{wrong}"
    return Case("reconstruct", problem.name, subject, size, make, round(noise, 3), dtype)


def height_cases(draws: int, first: int = 0) -> Iterator[Case]:
    """`draws` rigs from frames to height, in which errors that neighbours have in common add up; a number's
    rig, its frames and their noise are those of `rig_case`."""
    for number in range(first, first + draws):
        decoded = rig_case(number)
        yield replace(decoded, part="height", name=f"rig {number}", make=partial(_solved_rig, number))


def _solved_rig(number: int) -> Found:
    rig, code, sensor = rig_of(number)
    seen, area, _ = seen_area(rig.scene, rig.surface, code, sensor, number, rig.lighting)
    height = reconstruct(seen, rig.scene, anchor=_known_point(seen, area.centre))
    return replace(found_height(height, area.centre, 1.0), unit="mm")


def _known_point(seen: Correspondence, truth: Trace) -> tuple[float, float, float]:
    """The true place (mm) on the mirror of the good pixel that is farthest from any that is not."""
    inside = distance_transform_cdt(np.pad(seen.good & truth.visible, 1))[1:-1, 1:-1]
    if not inside.any():
        raise InputError("no pixel is good")
    at = np.unravel_index(int(inside.argmax()), inside.shape)
    return float(truth.x[at]), float(truth.y[at]), float(truth.z[at])


def scene_cases(count: int, first: int) -> Iterator[Case]:
    """All of SCENES for so many numbers, the wrong ones with a rest capture too; kinds of rigs take turns."""
    for number in range(first, first + count):
        for which in SCENES:
            for rest in (False, True)[: 1 if which == SCENES[0] else 2]:
                name = f"{which}{', rest capture' if rest else ''}: {number}"
                make, limit = partial(scene_found, number, which, rest), _REST if rest else ""
                yield Case("scene", name, KINDS[number % len(KINDS)], _SIZE, make, limit=limit)


def scene_found(number: int, which: str, rest: bool) -> Found:
    """The height by one of SCENES, errors over the depth of the usual dent; without a rest capture, whether a
    notice tells of the wrong ones."""
    rng = np.random.default_rng([0, number, 28])
    rig = draw_rig(rng, KINDS[number % len(KINDS)], _SIZE)
    noise = between(rng, 0.002, 0.1)
    truth, flat = trace(rig.scene, rig.surface), trace(rig.scene, dent("flat", rig.scene))
    seen, at_rest = (exact(one, noise=noise, rng=rng) for one in (truth, flat))
    inner = distance_transform_edt(np.pad(truth.visible & flat.visible, 1))[1:-1, 1:-1]
    row, col = (int(at) for at in np.unravel_index(int(np.argmax(inner)), inner.shape))
    anchor = PixelAnchor(row, col, float(truth.z[row, col]))
    pitch = rig.scene.pattern.pitch * (1 + float(rng.choice([-1.0, 1.0])) * _PITCH)
    turn = turned(rig.scene, rng.standard_normal(3), _TURN)
    scenes = (rig.scene, turn, replace(rig.scene, pattern=replace(rig.scene.pattern, pitch=pitch)))
    scene = scenes[SCENES.index(which)]
    height = reconstruct(seen, scene, anchor=anchor, rest=at_rest if rest else None)
    told = tuple(str(notice) for notice in height.notices)
    wrong = "" if which == SCENES[0] else which
    said = FrameVerdict(wrong, True, False, bool(told), 0 if wrong else len(told), told)
    usual = dent("gaussian", rig.scene).formula
    assert usual is not None  # named forms have one
    found = found_height(height, truth, usual.params["peak"])
    return found if rest else replace(found, frames=said)


def turned(scene: Scene, axis: NDArray[np.float64], angle: float) -> Scene:
    """The scene with its camera turned about an axis (3,) by an angle (rad)."""
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    u_axis, v_axis = turn.apply([scene.camera.u_axis, scene.camera.v_axis])
    return replace(scene, camera=replace(scene.camera, u_axis=u_axis, v_axis=v_axis))


def curved_cases(scenes: int, first: int = 0) -> Iterator[Case]:
    """Every code on so many drawn scenes: in turn a form of dent each; four in the preset, four on rigs."""
    for number in range(first, first + scenes):
        _, size, noise = _drawn(number)
        for code in CURVED_CODES:
            name, make = f"{FORMS[number % len(FORMS)]} {number}", partial(curved_found, number, code)
            yield Case("curved", name, code, size, make, noise, "uint8", "", AREA_SHARE, AREA_PIXELS)


def curved_scene(number: int) -> tuple[Scene, Surface, Sensor]:
    """The scene of a number, always the same."""
    rng, size, noise = _drawn(number)
    if number // len(FORMS) % 2:
        scene = draw_rig(rng, str(rng.choice(KINDS)), size).scene
    else:
        scene = resize(load("prism48", exact=True), *size)
    draw = (_relief, _ripples, _ridge, _ball)[number % len(FORMS)]
    return scene, draw(rng, scene), Sensor(noise=noise)


def curved_found(number: int, code: str) -> Found:
    """Render, decode, compare."""
    scene, surface, sensor = curved_scene(number)
    return found_area(*seen_area(scene, surface, code, sensor, number))


def _drawn(number: int) -> tuple[np.random.Generator, tuple[int, int], float]:
    """Random numbers of a scene, its camera's size and noise."""
    rng = np.random.default_rng([_SEED_CURVED, number])
    return rng, drawn_size(rng, _CURVED), float(rng.choice(_NOISES))


def _relief(rng: np.random.Generator, scene: Scene) -> Surface:
    """Ten to forty bumps and hollows."""
    length, width = scene.mirror.length, scene.mirror.width
    count = int(rng.integers(10, 40))
    sigma = length * rng.uniform(0.015, 0.08, count)
    x0, y0 = length * rng.uniform(0.1, 0.8, count), width * rng.uniform(0.1, 0.9, count)
    peak = np.radians(rng.uniform(-1.5, 1.5, count)) * sigma
    bumps = [
        partial(dent, "gaussian", x=x, y=y, sigma=width, peak=height)
        for x, y, width, height in zip(x0, y0, sigma, peak, strict=True)
    ]
    return together(bumps, scene)


def _ripples(rng: np.random.Generator, scene: Scene) -> Surface:
    """A plane wave of 3 to 15 % of the mirror's length, that fades out towards x = L0; at least _WAVE pixels
    long (shorter ones alias: no pixels of a camera tell them from long ones)."""
    length = scene.mirror.length
    wave = 2 * np.pi / max(length * rng.uniform(0.03, 0.15), _WAVE * _pixel(scene))
    angle = rng.uniform(0, np.pi)
    kx, ky = wave * np.cos(angle), wave * np.sin(angle)
    size = np.radians(rng.uniform(0.3, 2.0)) / wave

    def form(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        t = np.clip((length - x) / (0.1 * length), 0.0, 1.0)
        fade, change = t**3 * (10 - 15 * t + 6 * t * t), -30 * t * t * (1 - t) ** 2 / (0.1 * length)
        up, across = 1 + np.cos(kx * x + ky * y), -np.sin(kx * x + ky * y)
        slope_x, slope_y = change * up + fade * kx * across, fade * ky * across
        return np.asarray(size * fade * up), size * slope_x, size * slope_y

    return surface_of(form)


def _pixel(scene: Scene) -> float:
    """Distance of neighbouring pixels on the mirror at rest, mm: the larger one of both axes, median."""
    rest = trace(scene, dent("flat", scene))
    points = np.stack([rest.x, rest.y])
    steps = [np.hypot(*np.diff(points, axis=axis)) for axis in (1, 2)]
    return float(max(np.nanmedian(step) for step in steps))


def _ridge(rng: np.random.Generator, scene: Scene) -> Surface:
    """1 to 4.2 degrees steep."""
    length = scene.mirror.length
    sigma = length * rng.uniform(0.01, 0.05)
    peak = np.radians(rng.uniform(1.0, 4.2)) * sigma * np.exp(0.5)
    place = {"x": rng.uniform(0.3, 0.7) * length, "angle_deg": rng.uniform(0, 90)}
    return dent("ridge", scene, peak=peak, sigma=sigma, **place)


def _ball(rng: np.random.Generator, scene: Scene) -> Surface:
    """Its contact has an edge at which the slope jumps."""
    length, width = scene.mirror.length, scene.mirror.width
    contact = rng.uniform(0.03, 0.12) * min(length, width)
    peak = contact * rng.uniform(np.tan(np.radians(1.0)), np.tan(_STEEPEST))
    place = {"x": rng.uniform(0.3, 0.7) * length, "y": rng.uniform(0.3, 0.7) * width}
    return dent("ball", scene, peak=peak, radius=contact**2 / peak, **place)
