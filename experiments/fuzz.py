"""The program attacked: inputs damaged at random, of every kind that it reads, each by its number.

A case must end with 0 and a result that holds, or with 2, one line on stderr and no result.
"""

import io
import json
import re
import resource
import shutil
import signal
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from optolever.decode import Correspondence, decode
from optolever.errors import InputError
from optolever.patterns import sequence
from optolever.projector import Capture, capture
from optolever.reconstruct import HeightMap
from optolever.scene import Scene, dent, load, resize, trace

__all__ = ["FUZZED", "Outcome", "fuzz"]

Run = Callable[[list[str]], int]

#: A case may take so many seconds, and so many bytes more than the process had at its start.
_SECONDS, _BYTES = 30, 4 << 30
_SIZE = 24, 32
#: Heights of a mirror of 48 mm that no dent has, mm; places that no pattern has, pattern px.
_DEEPEST, _WIDEST = 48.0, 65536.0
_EXTREMES = (
    *("0", "-1", "1e308", "-1e308", "1e-308", "nan", "inf", "65536", "65537", "20000", "0.5", "true"),
    *('"x"', '""', "[]", "{}", "[1, 2]", "99999999999999999999", "\\u0000", "1979-05-27"),
)
_WORDS = ("prism48", "gray", "phase:steps=1000000", "nosuch", "", "-", "/dev/null", "/", "1e400", "--", "0x0")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a case did. code: its exit code, None if it did not end by itself; fault: '' if it held."""

    number: int
    kind: str
    args: tuple[str, ...]
    code: int | None
    seconds: float
    fault: str


def fuzz(run: Run, cases: int, seed: int, folder: Path) -> Iterator[Outcome]:
    """Run so many cases through `run`, the program in this process. folder: empty, for their files."""
    base = _base(folder / "base")
    kinds = [kind for kind in FUZZED if kind != "hdf5" or find_spec("h5py")]
    for number in range(seed, seed + cases):
        rng = np.random.default_rng([number, 28])
        work = folder / "case"
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(base, work)
        kind = str(rng.choice(kinds))
        args = [str(word).replace("@", str(work)) for word in FUZZED[kind](rng, work)]
        yield _outcome(run, number, kind, args, work)


def _outcome(run: Run, number: int, kind: str, args: list[str], work: Path) -> Outcome:
    before = _peak(anew=True)
    said, start, code, fault = io.StringIO(), time.perf_counter(), None, ""
    try:
        with redirect_stderr(said), redirect_stdout(io.StringIO()), _limited():
            code = run(args)
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except BaseException:
        fault = traceback.format_exc(limit=-1)
    seconds, lines = time.perf_counter() - start, said.getvalue().strip().splitlines()
    results = [work / name for name in ("out.npz", "out", "sweep/results.json")]
    if not fault:
        if code == 0:
            fault = next(filter(None, (_unsound(result) for result in results if result.exists())), "")
        elif code != 2 or len(lines) != 1:
            fault = f"exit code {code}, {len(lines)} lines: {' / '.join(lines)[:200]}"
        elif any(result.exists() for result in results):
            fault = "refused, and something is written"
    if seconds > _SECONDS:
        fault = f"{seconds:.0f} s"
    if _peak() - before > _BYTES:
        fault = fault or f"{(_peak() - before) / 2**30:.1f} GiB"
    return Outcome(number, kind, tuple(args), code, seconds, fault)


def _unsound(path: Path) -> str:
    """What is wrong with a result: it cannot be read, or pixels that are good are no numbers or far off all
    that is there."""
    try:
        values, most = _values(path)
    except (InputError, ValueError) as error:
        return f"{path.name} cannot be read: {error}"
    for value in values:
        off = value[~(np.abs(value) < most)]
        if off.size:
            return f"unflagged values of {off[0]}"
    return ""


def _values(path: Path) -> tuple[list[Any], float]:
    """What a result says of good pixels, and what all of it must be below."""
    if path.is_dir():
        return [Capture.load(path).frames.ravel()], float("inf")
    if path.suffix == ".json":
        return [np.zeros(len(json.loads(path.read_text(encoding="utf-8"))))], float("inf")
    try:
        height = HeightMap.load(path)
        return [height.z[height.good], height.sigma[height.good]], _DEEPEST
    except InputError:
        found = Correspondence.load(path)
        maps = (found.u, found.v, found.sigma_u, found.sigma_v)
        return [value[found.good] for value in maps], _WIDEST


class _TooLong(BaseException):
    """Not to be caught by what reads files: TimeoutError is an OSError."""


@contextmanager
def _limited() -> Iterator[None]:
    """_TooLong after _SECONDS, where Python runs."""

    def stop(*_: Any) -> None:
        raise _TooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(_SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _peak(anew: bool = False) -> int:
    """The most bytes that the process had; anew: from now on, where the system can (Linux)."""
    with suppress(OSError):
        if anew:
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        found = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text(encoding="ascii"))
        if found:
            return int(found[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _base(folder: Path) -> Path:
    """Files that are in order: a capture with its scene and truth, what it decodes to, a sequence, a grid."""
    scene: Scene = resize(load("prism48"), *_SIZE)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    surface = dent("gaussian", scene, peak=0.2)
    taken = capture(scene, surface, shown, renderer="numpy", noise=1.0)
    folder.mkdir(parents=True)
    taken.save(folder / "capture")
    scene.save(folder / "scene.toml")
    shown.save(folder / "sequence.toml")
    decode(taken.frames, shown).save(folder / "c.npz")
    trace(scene, surface).save(folder / "truth.npz")
    cv2.imwrite(str(folder / "mask.png"), np.full(_SIZE, 255, np.uint8))
    cv2.imwrite(str(folder / "mask.tif"), np.full(_SIZE, 255, np.uint8))
    return folder


def _bytes(rng: np.random.Generator, path: Path) -> None:
    """Flip, cut, repeat or blank bytes of a file."""
    data = bytearray(path.read_bytes())
    at, count = int(rng.integers(len(data))), int(rng.integers(1, 64))
    way = rng.integers(4)
    if way == 0:
        for place in rng.integers(len(data), size=count):
            data[place] ^= 1 << int(rng.integers(8))
    elif way == 1:
        del data[at:]
    elif way == 2:
        data[at:at] = data[at : at + count]
    else:
        data[at : at + count] = bytes(len(data[at : at + count]))
    path.write_bytes(data)


def _toml(rng: np.random.Generator, path: Path) -> None:
    """Replace values, drop or repeat lines, or damage bytes."""
    if rng.random() < 0.2:
        _bytes(rng, path)
        return
    lines = path.read_text(encoding="utf-8").splitlines()
    for _ in range(rng.integers(1, 3)):
        filled = [i for i, line in enumerate(lines) if line.strip()]
        i, way = int(rng.choice(filled)), rng.random()
        if way < 0.7 and "=" in lines[i]:
            key, _, value = lines[i].partition("=")
            number = list(re.finditer(r"-?[\d.]+(e-?\d+)?|\w+", value))
            extreme = str(rng.choice(_EXTREMES))
            if number and rng.random() < 0.7:
                one = number[int(rng.integers(len(number)))]
                if rng.random() < 0.4:
                    extreme = _nudged(rng, one[0])
                value = value[: one.start()] + extreme + value[one.end() :]
                lines[i] = f"{key}={value}"
            else:
                lines[i] = f"{key}= {extreme}"
        elif way < 0.85:
            lines[i] = ""
        else:
            lines.insert(i, lines[i])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _nudged(rng: np.random.Generator, text: str) -> str:
    """A number near another one, whole where that is; other text as it was."""
    try:
        value = float(text) * float(np.exp(0.3 * rng.standard_normal()))
    except ValueError:
        return text
    return str(round(value)) if text.lstrip("-").isdigit() else f"{value:.6g}"


def _array(rng: np.random.Generator, value: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """An array with other values, another type or another shape."""
    way, flat = rng.integers(6), np.array(value).ravel()
    if way == 0 and flat.size and value.dtype.kind == "f":
        flat[rng.integers(flat.size, size=3)] = rng.choice([np.nan, np.inf, -np.inf, 1e38, -1e6, 0.0, -1.0])
        return flat.reshape(value.shape)
    if way == 1:
        return value[:-1] if value.ndim else np.zeros(3)
    if way == 2:
        return np.zeros((0, *value.shape[1:]), value.dtype)
    if way == 3:
        return (
            value.astype(rng.choice(["c16", "U8", "i1", "f2", "?"])) if value.dtype.kind in "fiu" else value
        )
    if way == 4:
        return np.array("text") if rng.random() < 0.5 else np.zeros((2,) * 7)
    return value[..., None]


def _npz(rng: np.random.Generator, path: Path) -> None:
    if rng.random() < 0.5:
        _bytes(rng, path)
        return
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = str(rng.choice(list(arrays)))
    if rng.random() < 0.1:
        del arrays[name]
    else:
        with np.errstate(all="ignore"):
            arrays[name] = _array(rng, arrays[name])
    np.savez(path, **arrays)


def _hdf5(rng: np.random.Generator, path: Path) -> None:
    """A measurement as SOFAST writes it, small, with one field, or none, that is not what it should be."""
    import h5py

    shape = (*_SIZE, 2)
    fields: dict[str, Any] = {
        "fringe_images": np.zeros((*_SIZE, 8), np.uint8),
        "mask_images": np.zeros(shape, np.uint8),
        "fringe_periods_x": np.array([1.0]),
        "fringe_periods_y": np.array([1.0]),
    }
    fields["fringe_images"][:] = rng.integers(0, 255, fields["fringe_images"].shape)
    wrong = str(rng.choice([*fields, "none"]))
    with h5py.File(path, "w") as file:
        for name, value in fields.items():
            full = f"MeasurementSofastFringe/{name}"
            if name == wrong and rng.random() < 0.3:
                huge = tuple(int(size) for size in rng.integers(1, 1 << 20, 3))
                file.create_dataset(full, huge, "u1", chunks=(1, 1, 1))
            elif name == wrong:
                with np.errstate(all="ignore"):
                    changed = _array(rng, value)
                file[full] = changed if changed.dtype.kind != "U" else "text"
            else:
                file[full] = value
    if rng.random() < 0.3:
        _bytes(rng, path)


_Words = list[str]


def _of_scene(rng: np.random.Generator, work: Path) -> _Words:
    _toml(rng, work / "scene.toml")
    return ["reconstruct", "@/c.npz", "--scene", "@/scene.toml", "--out", "@/out.npz"]


def _of_capture(rng: np.random.Generator, work: Path) -> _Words:
    _toml(rng, work / "capture/capture.toml")
    return ["decode", "@/capture", "--out", "@/out.npz"]


def _of_sequence(rng: np.random.Generator, work: Path) -> _Words:
    _toml(rng, work / "sequence.toml")
    given = ["--scene", "prism48", "--size", f"{_SIZE[0]}x{_SIZE[1]}", "--renderer", "numpy"]
    return ["capture", *given, "--sequence", "@/sequence.toml", "--out", "@/out"]


def _of_grid(rng: np.random.Generator, work: Path) -> _Words:
    grid = 'scenes = ["prism48"]\nsequences = ["gray"]\nsizes = ["12x16"]\nnoises = [1.0]\nseeds = [0]\n'
    (work / "grid.toml").write_text(grid + 'renderer = "numpy"\nsolvers = ["fixed-point"]\nrefresh = 60.0\n')
    _toml(rng, work / "grid.toml")
    return ["sweep", "@/grid.toml", "--workers", "0", "--out", "@/sweep"]


def _of_frames(rng: np.random.Generator, work: Path) -> _Words:
    frames = sorted((work / "capture/frames").iterdir())
    _bytes(rng, frames[int(rng.integers(len(frames)))])
    return ["decode", "@/capture", "--out", "@/out.npz"]


def _of_masks(rng: np.random.Generator, work: Path) -> _Words:
    name = str(rng.choice(["mask.png", "mask.tif"]))
    _bytes(rng, work / name)
    if rng.random() < 0.5:
        return ["decode", "@/capture", "--mask", f"@/{name}", "--out", "@/out.npz"]
    return ["reconstruct", "@/c.npz", "--scene", "@/scene.toml", "--mask", f"@/{name}", "--out", "@/out.npz"]


def _of_arrays(rng: np.random.Generator, work: Path) -> _Words:
    which = str(rng.choice(["c.npz", "truth", "rest"]))
    if which == "c.npz":
        _npz(rng, work / which)
        return ["reconstruct", "@/c.npz", "--scene", "@/scene.toml", "--out", "@/out.npz"]
    shutil.copy(work / ("truth.npz" if which == "truth" else "c.npz"), work / "other.npz")
    _npz(rng, work / "other.npz")
    given = ["--scene", "@/scene.toml", f"--{which}", "@/other.npz"]
    return ["reconstruct", "@/c.npz", *given, "--out", "@/out.npz"]


def _of_hdf5(rng: np.random.Generator, work: Path) -> _Words:
    _hdf5(rng, work / "m.h5")
    return ["decode", "@/m.h5", "--out", "@/out.npz"]


def _of_words(rng: np.random.Generator, work: Path) -> _Words:
    """Arguments replaced, dropped, repeated."""
    words = [
        [
            "capture",
            "--scene",
            "@/scene.toml",
            "--sequence",
            "gray+phase:steps=4",
            "--noise",
            "1",
            "--seed",
            "1",
        ],
        ["decode", "@/capture", "--noise", "1", "--roi", "0:20,0:30"],
        ["reconstruct", "@/c.npz", "--scene", "@/scene.toml", "--method", "coupled", "--anchor", "edge"],
    ][int(rng.integers(3))]
    words += ["--out", "@/out" if words[0] == "capture" else "@/out.npz"]
    i, way = int(rng.integers(1, len(words) - 2)), rng.integers(4)
    if way == 0:
        del words[i]
    elif way == 1:
        words.insert(i, words[i])
    elif way == 2:
        words[i] = str(rng.choice([*_WORDS, *_EXTREMES]))
    else:
        cut = int(rng.integers(len(words[i])))
        words[i] = words[i][:cut] + str(rng.choice(_EXTREMES)) + words[i][cut + 1 :]
    return words


#: What is damaged, and the command that is to read it.
FUZZED: dict[str, Callable[[np.random.Generator, Path], _Words]] = {
    "scene": _of_scene,
    "capture": _of_capture,
    "sequence": _of_sequence,
    "grid": _of_grid,
    "frames": _of_frames,
    "masks": _of_masks,
    "arrays": _of_arrays,
    "hdf5": _of_hdf5,
    "arguments": _of_words,
}
