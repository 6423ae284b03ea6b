"""What `live` costs beside two cosine transforms, and how right it is: dents, contacts, a vibration."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from optolever.live import TRACES, Live, Probes, Spectrum
from optolever.scene import load, resize

from .streams import NOISE, Dents, StreamRig, stream_rig
from .world import BALL, GAUSS, expose, photons

__all__ = ["CASES", "LiveRow", "Vibration", "live_rows", "transforms_ms", "trembling", "vibration"]

#: Frames of a case.
CASES: dict[str, tuple[Dents, ...]] = {
    "smooth": tuple(((GAUSS, 26.0 + 2 * k, 22.5, 8.0, 0.08 + 0.05 * k),) for k in range(5)),
    "contact": tuple(((BALL, 28.0 + k, 20.0 + k, 4.0, 0.05 + 0.01 * k),) for k in range(5)),
}
_REPEATS = 3


@dataclass(frozen=True)
class LiveRow:
    """One case: time of one core over that of two float32 transforms (median), largest rms error over the
    depth, error over sigma (rms over the frames), share beyond five, frames that were trusted."""

    case: str
    cell: int
    ms: float
    ratio: float
    error: float
    sigma_ratio: float
    beyond: float
    trusted: float


def transforms_ms(rows: int, cols: int) -> float:
    """Processor time of two float32 cosine transforms, the median of 9."""
    image = np.random.default_rng(0).standard_normal((rows, cols), dtype=np.float32)
    times = []
    for _ in range(9):
        start = time.process_time()
        scipy.fft.idctn(scipy.fft.dctn(image, norm="ortho"), norm="ortho")
        times.append(time.process_time() - start)
    return 1e3 * float(np.median(times))


def live_rows(size: tuple[int, int], cells: tuple[int, ...], seed: int) -> Iterator[LiveRow]:
    """Every case with every cell on prism48, rendered once."""
    scene = resize(load("prism48"), *size)
    rigs = {cell: stream_rig(scene, cell) for cell in cells}
    some = next(iter(rigs.values()))
    for case, frames in CASES.items():
        worlds = {
            cell: replace(rig, world=replace(rig.world, fading=case != "contact"))
            for cell, rig in rigs.items()
        }
        lights = [worlds[some.prepared.rig.carriers.cell].light(dents, 4) for dents in frames]
        for cell, rig in worlds.items():
            yield _row(rig, case, cell, frames, lights, seed)


def _row(
    rig: StreamRig,
    case: str,
    cell: int,
    frames: tuple[Dents, ...],
    lights: list[NDArray[np.float32]],
    seed: int,
) -> LiveRow:
    rng, live = np.random.default_rng(seed), Live(rig.prepared)
    times, errors, ratios, beyond, trusted, ours = [], [], [], [], [], []
    for _ in range(_REPEATS):
        for dents, light in zip(frames, lights, strict=True):
            frame = expose(light, rng, NOISE)
            ours.append(transforms_ms(*frame.shape))
            start = time.process_time()
            reading = live.update(frame)
            times.append(1e3 * (time.process_time() - start))
            error = reading.z - rig.truth(dents)
            inner = reading.good & (reading.x > 6)
            errors.append(float(error[inner].std()) / dents[0][4])
            ratio = (error / reading.sigma)[reading.good]
            ratios.append(float(np.mean(np.square(ratio))))
            beyond.append(float(np.mean(np.abs(ratio) > 5)))
            trusted.append(reading.trusted)
    ms = float(np.median(times))
    share = np.asarray(times) / np.asarray(ours)
    return LiveRow(
        case, cell, ms, float(np.median(share)), max(errors),
        float(np.sqrt(np.mean(ratios))), float(np.mean(beyond)), float(np.mean(trusted)),
    )  # fmt: skip


def trembling(
    rig: StreamRig, frames: int, pixels: float, sunk_nm: float = 0.0, rate: float = 60.0, seed: int = 1
) -> dict[str, Spectrum]:
    """Spectra of two probes of a mirror at rest by trace (the second's), the camera's picture shifted in each
    frame by a normal deviate of so many pixels along columns and along rows; sunk_nm: amplitude of 7 Hz by
    which the mirror sinks as a whole. The light is quadratic in so small a shift."""
    step, far = 0.05, 1e-6 * max(sunk_nm, 1.0)
    whole = ((GAUSS, 30.0, 22.5, 1e4, far),)
    worlds = [rig.world, *(rig.world.moved(*way) for way in ((-step, 0), (step, 0), (0, -step), (0, step)))]
    still, left, right, up, down = (replace(rig, world=world).light((), 4) for world in worlds)
    sunk = replace(rig, world=replace(rig.world, fading=False)).light(whole, 4) - still
    rng, live, probes = np.random.default_rng(seed), Live(rig.prepared), Probes(rig.prepared)
    for place in ((18.0, 15.0), (40.0, 28.0)):
        probes.add(*place)
    for k in range(frames):
        light = still + sunk * float(np.sin(14 * np.pi * k / rate)) * (sunk_nm > 0)
        for (less, more), part in zip(
            ((left, right), (up, down)), rng.normal(0, pixels / step, 2), strict=True
        ):
            light = light + 0.5 * part * (more - less) + 0.5 * part**2 * (more + less - 2 * still)
        probes.read(live.update(photons(light.astype(np.float32), rng), k / rate), k)
    found = {trace: probes.spectra(trace=trace)[1] for trace in TRACES}
    return {trace: one for trace, one in found.items() if one is not None}


@dataclass(frozen=True)
class Vibration:
    """Of a surface that vibrates: median of the spectrum's bins, nm; amplitudes read, nm, at each frequency,
    Hz; sigma of the height of a frame, nm; processor time a frame, ms."""

    floor_nm: float
    read_nm: dict[float, float]
    frame_nm: float
    ms: float


def vibration(
    rig: StreamRig, seconds: float, true_nm: dict[float, float], rate: float = 60.0, seed: int = 1
) -> Vibration:
    """A smooth dent of 8 mm whose depth is the sum of sines (amplitude, nm, by frequency, Hz), in frames with
    photon noise; the light is quadratic in so small a depth."""
    place, size = (30.0, 22.5), 1e-6 * sum(true_nm.values())
    below, rest, above = (rig.light(((GAUSS, *place, 8.0, k * size),), 4) for k in (-1, 0, 1))
    rng, live, probes, times = np.random.default_rng(seed), Live(rig.prepared), Probes(rig.prepared), []
    probes.add(*place)
    for k in range(round(rate * seconds)):
        phase = 2 * np.pi * k / rate
        depth = 1e-6 * sum(nm * np.sin(hz * phase) for hz, nm in true_nm.items()) / size
        light = rest + 0.5 * depth * (above - below) + 0.5 * depth**2 * (above + below - 2 * rest)
        frame = photons(light.astype(np.float32), rng)
        start = time.process_time()
        probes.read(live.update(frame, k / rate), k)
        times.append(1e3 * (time.process_time() - start))
    (spectrum,) = probes.spectra()
    assert spectrum is not None
    read = {
        hz: 1e6
        * max((line.amplitude for line in spectrum.lines if abs(line.hz - hz) < 1 / seconds), default=0)
        for hz in true_nm
    }
    floor, frame = 1e6 * spectrum.floor, 1e6 * spectrum.density * np.sqrt(rate / 2)
    return Vibration(floor, read, float(frame), float(np.median(times)))
