"""The program attacked: inputs damaged at random, of every kind that it reads, each by its number.

A case must end with 0 and a result that holds, or with 2, one line on stderr for each refused input and no
result.
"""

import io
import os
import re
import resource
import shutil
import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TextIO

import click
import cv2
import numpy as np

from optolever.calibration import RigResponse, store_response
from optolever.decode import Correspondence, Response, decode, estimate_profile
from optolever.errors import InputError
from optolever.live import Live, ReadingRecorder, follow, virtual_rig
from optolever.patterns import sequence
from optolever.projector import Capture, capture
from optolever.reconstruct import HeightMap, contacts, reconstruct, slope_map
from optolever.scene import Covariance, Scene, dent, load, resize, trace

from .damage import EXTREMES, damage, save_sofast

Run = Callable[[list[str]], int]

#: A case may take so many seconds of the processor, and so many bytes more than the process had at its start.
_SECONDS, _BYTES = 30, 4 << 30
#: Nothing is waited for longer than so many seconds by the clock.
_HANGS = 300
_SIZE = 24, 32
#: Places that no pattern has, pattern px.
_WIDEST = 65536.0
#: Heights may be off by so many sigma.
_SIGMAS = 5.0
#: Messages of Python where a program has none.
_PYTHON = re.compile(
    "object has no|Errno|not supported between|unhashable|subscriptable|not iterable|must be real number,|"
    "positional arg|keyword arg|index out of|out of range|unpack|NoneType|invalid literal|could not convert|"
    "codec can't|buffer|required argument|allow_pickle|broadcast|cannot reshape|Error\\b|ndarray|__"
)
#: In each line of several refused inputs, behind the input's name.
_BATCH = ": optolever: "
#: What the commands read.
_SOURCES = {
    "simulate": ["--scene", "@/scene.toml", "--renderer", "numpy"],
    "decode": ["@/capture"],
    "reconstruct": ["@/c.npz", "--scene", "@/scene.toml"],
}
_DENTS = ("flat", "tilt", "raised-cosine", "gaussian:peak=0.3", "ball:radius=5,depth=0.3", "needle", "ridge")
_CODES = ("gray", "binary:cell=2", "phase:steps=3", "gray+phase:steps=4", "micro-phase", "stripe")
#: What options hold, to which their type does not tell it; "" stands for all others: numbers and names.
_TEXTS = {
    "--sequence": (*_CODES, "long-run-gray", "lattice", "crossed", "ramp", "@/sequence.toml"),
    "--dent": (*_DENTS, "rounded-needle", "relief:path=@/mask.png", "gaussian:peak=-9", "ball:depth=40"),
    "--pixels": ("1x1", "2x2", "16x12", "32x24", "200x3", "64x64"),
    "--mask": ("0,0,24,32", "3,3,1,1", "0,0,1,32", "20,30,4,2", "24,0,1,1", "-1,0,2,2"),
    "--anchor": ("edge", "none", "30,20,0", "30,20,1", "0,0,0", "1e9,0,0", "nan,0,0"),
    "": ("0", "1", "7", "20", "0.3", "1e-9", "1e4", "1e9", "99999999999"),
}
_SUFFIXES = (".npz", ".tif", ".x3p", ".ply", ".json")
#: The share of a command's options that are given.
_GIVEN = 0.25
_RECONSTRUCT = "reconstruct @/c.npz --scene @/scene.toml --out @/out.npz"
_DECODE = "decode @/capture --out @/out.npz"
_CAPTURE = "simulate --renderer numpy --out @/out"
_MASKS = ("mask.png", "mask.tif")
_GRIDS = (".npz", ".csv", ".sdf", ".dat", ".x3p", ".tif", ".npy")
#: A kind, a file of it (or a folder of them) that is damaged, and a command that reads that.
_KINDS: tuple[tuple[str, str, str], ...] = (
    ("scene", "scene.toml", _RECONSTRUCT),
    ("scene", "scene.toml", f"{_CAPTURE} --scene @/scene.toml"),
    ("capture", "capture/capture.toml", _DECODE),
    ("sequence", "sequence.toml", f"{_CAPTURE} --scene @/scene.toml --sequence @/sequence.toml"),
    ("frames", "capture/frames", _DECODE),
    *(
        ("masks", mask, f"{command} --mask @/{mask}")
        for mask in _MASKS
        for command in (_DECODE, _RECONSTRUCT)
    ),
    ("arrays", "c.npz", _RECONSTRUCT),
    ("arrays", "truth.npz", f"{_RECONSTRUCT} --truth @/truth.npz"),
    ("arrays", "rest.npz", f"{_RECONSTRUCT} --rest @/rest.npz"),
    ("hdf5", "m.h5", "decode @/m.h5 --out @/out.npz"),
    ("heights", "h.npz", "form @/h.npz"),
    ("heights", "h.npz", "export @/h.npz @/x.csv"),
    ("heights", "s.npz", "form @/h.npz --slopes @/s.npz"),
    *(("grids", f"g{suffix}", f"form @/g{suffix}") for suffix in _GRIDS),
    ("rig", "rig.calibration.npz", "reconstruct @/c.npz --scene @/rig.toml --no-rest --out @/out.npz"),
    ("rig", "rig.profile.npz", f"{_DECODE} --profile @/rig.toml"),
    ("rig", "rig.response.npz", f"{_DECODE} --response @/rig.toml"),
    ("stack", "stack.npy", "decode @/stack.npy --description @/sequence.toml --out @/out.npz"),
    ("recording", "film/log.jsonl", "camera replay @/film"),
    ("recording", "film/frames.zst", "camera replay @/film"),
    ("recording", "film/prepared.npz", "camera replay @/film"),
)
FUZZED = (*dict.fromkeys(kind for kind, *_ in _KINDS), "arguments")
_WORDS = ("prism48", "gray", "phase:steps=1000000", "nosuch", "", "-", "/dev/null", "/", "1e400", "--", "0x0")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a case did. code: its exit code, None if it did not end by itself; bytes: the most that it had
    more than the process had at its start; fault: '' if it held."""

    number: int
    kind: str
    args: tuple[str, ...]
    code: int | None
    seconds: float
    bytes: int
    fault: str


def fuzz(
    run: Run, program: click.Group, cases: int, seed: int, first: int, folder: Path
) -> Iterator[Outcome]:
    """Run so many cases through `run`, the program in this process, each drawn by seed and number.
    program: its commands; folder: empty, for their files."""
    base = _base(folder / "base")
    _compile(run, base)
    kinds = [kind for kind in FUZZED if kind != "hdf5" or find_spec("h5py")]
    for number in range(first, first + cases):
        rng = np.random.default_rng([seed, number])
        work = folder / "case"
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(base, work)
        kind = str(rng.choice(kinds))
        words = _arguments(rng, program, work) if kind == "arguments" else _damaged(rng, kind, work)
        args = [word.replace("@", str(work)) for word in words]
        yield _outcome(run, number, kind, args, work)


def _damaged(rng: np.random.Generator, kind: str, work: Path) -> list[str]:
    """The command that reads a damaged file of a kind."""
    of_kind = [row for row in _KINDS if row[0] == kind]
    _, name, command = of_kind[int(rng.integers(len(of_kind)))]
    damage(rng, work / name)
    return command.split()


def _outcome(run: Run, number: int, kind: str, args: list[str], work: Path) -> Outcome:
    before = _peak(anew=True)
    start, code, fault = time.process_time(), None, ""
    with (work / "stderr").open("w+", encoding="utf-8", errors="replace") as said:
        try:
            strict = warnings.catch_warnings(action="error", category=RuntimeWarning)
            with chdir(work), _into(said), redirect_stdout(io.StringIO()), _limited(), strict:
                code = run(args)
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 1
        except BaseException:
            fault = traceback.format_exc(limit=-1)
        seconds = time.process_time() - start
        said.seek(0)
        lines = said.read().strip().splitlines()
    results = [work / name for name in ("out.npz", "out")]
    if not fault:
        # with notices alone a map is written, every pixel of which is flagged: it contradicts its scene
        flagged = code == 2 and lines and all(line.startswith("Notice: ") for line in lines)
        if code == 2 and lines and all(_BATCH in line for line in lines):
            pass  # the other inputs of several have their results
        elif code == 0 or flagged:
            fault = next(filter(None, (_unsound(result) for result in results if result.exists())), "")
        elif code != 2 or len(lines) != 1:
            fault = f"exit code {code}, {len(lines)} lines: {' / '.join(lines)[:200]}"
        elif any(result.exists() for result in results):
            fault = "refused, and something is written"
        elif _PYTHON.search(lines[0].replace(str(work), "")):
            fault = f"Python's words: {lines[0][:200]}"
    if seconds > _SECONDS:
        fault = f"{seconds:.0f} s"
    grown = _peak() - before
    if grown > _BYTES:
        fault = fault or f"{grown / 2**30:.1f} GiB"
    return Outcome(number, kind, tuple(args), code, seconds, grown, fault)


def _unsound(path: Path) -> str:
    """What is wrong with a result: it cannot be read, or pixels that are good are no numbers or, without a
    notice, far off all that is there."""
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
    """What a result says of good pixels, and what all of it must be below: heights, as far as
    their sigma says so, the mirror's length."""
    if path.is_dir():
        return [Capture.load(path).frames.ravel()], float("inf")
    try:
        height = HeightMap.load(path)
        good = height.good
        length = max((np.ptp(each[good]) for each in (height.x, height.y) if good.any()), default=0.0)
        # a pixel alone, or a row of them, is no length
        most = float("inf") if height.notices or good.sum() < sum(good.shape) else length
        sigma = height.sigma[good]
        return [np.maximum(np.abs(height.z[good]) - _SIGMAS * sigma, 0.0), sigma], most
    except InputError:
        found = Correspondence.load(path)
        maps = (found.u, found.v, found.sigma_u, found.sigma_v)
        return [value[found.good] for value in maps], _WIDEST


def _compile(run: Run, base: Path) -> None:
    """Run what is in order, before the clock counts: loops are compiled once on a machine."""
    with redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
        given = [str(base / "c.npz"), "--scene", str(base / "scene.toml"), "--rest", str(base / "c.npz")]
        run(["reconstruct", *given, "--out", str(base / "out.npz")])
        for code in _TEXTS["--sequence"][:-1]:
            shutil.rmtree(base / "out", ignore_errors=True)
            given = ["--scene", str(base / "scene.toml"), "--renderer", "numpy", "--sequence", code]
            if run(["simulate", *given, "--out", str(base / "out")]) == 0:
                run(["decode", str(base / "out"), "--out", str(base / "out.npz")])
    shutil.rmtree(base / "out", ignore_errors=True)
    (base / "out.npz").unlink(missing_ok=True)


@contextmanager
def _into(said: TextIO) -> Iterator[None]:
    """What Python and the libraries below it write to stderr."""
    before = os.dup(2)
    try:
        with redirect_stderr(said):
            os.dup2(said.fileno(), 2)
            yield
            said.flush()
    finally:
        os.dup2(before, 2)
        os.close(before)


class _TooLong(BaseException):
    """Not to be caught by what reads files: TimeoutError is an OSError."""


@contextmanager
def _limited() -> Iterator[None]:
    """_TooLong after _HANGS, in Python."""

    def stop(*_: Any) -> None:
        raise _TooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(_HANGS)
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
    """Files that are in order: a capture with its scene and truth, what it decodes to, a sequence."""
    scene: Scene = resize(load("prism48", exact=True), *_SIZE)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    surface = dent("gaussian", scene, peak=0.2)
    taken = capture(scene, surface, shown, renderer="numpy", noise=1.0)
    folder.mkdir(parents=True)
    taken.save(folder / "capture")
    scene.save(folder / "scene.toml")
    shown.save(folder / "sequence.toml")
    decode(taken.frames, shown).save(folder / "c.npz")
    shutil.copy(folder / "c.npz", folder / "rest.npz")
    if find_spec("h5py"):
        save_sofast(folder / "m.h5", taken.frames)
    trace(scene, surface).save(folder / "truth.npz")
    _maps(folder, scene)
    _rig(folder, scene, taken)
    _film(folder / "film")
    for mask in _MASKS:
        cv2.imwrite(str(folder / mask), np.full(_SIZE, 255, np.uint8))
    return folder


def _maps(folder: Path, scene: Scene) -> None:
    """A height map with contacts and slopes, and its grid in every format that is read."""
    found = Correspondence.load(folder / "c.npz")
    height = reconstruct(found, resize(load("prism48"), *_SIZE))
    replace(height, contacts=contacts(height)).save(folder / "h.npz")
    slope_map(height, found, scene).save(folder / "s.npz")
    for suffix in _GRIDS:
        height.resample().export(folder / f"g{suffix}")


def _rig(folder: Path, scene: Scene, taken: Capture) -> None:
    """A rig with a covariance, the profile of the capture and a response."""
    names = ("camera.rx", "pattern.z")
    known = Covariance(
        names, np.diag([1e-3, 0.1]) ** 2, sources=("noise",), parts=np.diag([1e-3, 0.1])[None] ** 2
    )
    replace(scene, covariance=known).save(folder / "rig.toml")
    estimate_profile(taken.frames, taken.sequence).save(folder / "rig.toml")
    store_response(
        folder / "rig.toml", RigResponse(Response.from_gamma(1.0, blur=0.5), 0.0, np.ones(_SIZE), 0.1)
    )
    np.save(folder / "stack.npy", taken.frames)


def _film(folder: Path) -> None:
    """A recording of readings."""
    prepared, finger = virtual_rig(resize(load("prism48", exact=True), 72, 96))
    with ReadingRecorder(folder, prepared, "virtual") as recorder:
        for followed in follow(Live(prepared), finger, 3):
            recorder.write(followed)


def _arguments(rng: np.random.Generator, program: click.Group, work: Path) -> list[str]:
    """Arguments drawn from those that exist; in half of the cases one of them replaced, dropped, repeated."""
    name = str(rng.choice(list(_SOURCES)))
    words = [name, *_SOURCES[name]]
    command = program.get_command(click.Context(program), name)
    assert command is not None
    for option in command.params:
        if isinstance(option, click.Option) and not {*option.opts} & {*words, "--out"}:
            words += _option(rng, option, work) if rng.random() < _GIVEN else []
    words += ["--out", "@/out" if name == "simulate" else "@/out.npz"]
    if rng.random() < 0.5:
        return words
    i, way = int(rng.integers(1, len(words) - 1)), rng.integers(4)
    if way == 0:
        del words[i]
    elif way == 1:
        words.insert(i, words[i])
    elif way == 2:
        words[i] = str(rng.choice([*_WORDS, *EXTREMES]))
    else:
        cut = int(rng.integers(len(words[i])))
        words[i] = words[i][:cut] + str(rng.choice(EXTREMES)) + words[i][cut + 1 :]
    return words


def _option(rng: np.random.Generator, option: click.Option, work: Path) -> list[str]:
    """An option with a value of its type: a file that is there, one that is written, text."""
    name = option.opts[0]
    if option.is_flag:
        return [name]
    if type(option.type) is click.Path:
        values = [f"@/{path.relative_to(work)}" for path in sorted(work.rglob("*")) if path.suffix]
    elif isinstance(option.type, click.Path):
        values = [f"@/{name.strip('-')}{suffix}" for suffix in _SUFFIXES]
    else:
        values = list(_TEXTS.get(name, _TEXTS[""]))
    return [name, str(rng.choice(values))]
