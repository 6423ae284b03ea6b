"""Nothing that a command did not make, or was not asked to write, is lost or changed: every command of the
program, every output, on, above, below and linked to its inputs, and among files of others."""

import hashlib
import io
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import Mock

import click
import cv2
import numpy as np
import pytest

from optolever.cli import run
from optolever.cli.app import app
from optolever.cli.arguments import Shape
from optolever.cli.batch import Many
from optolever.cli.rig.questions import QUESTIONS

SIZE = ["--pixels", "32x24"]
#: Values of parameters by their metavar: required ones, wherever they are.
GIVEN = {
    "PRESET_OR_TOML": "rig.toml", "RIG.toml": "rig.toml", "C.npz": "c.npz", "H.npz": "h.npz",
    "H.npz...": "h.npz", "DIR|PATTERN|FILE": "capture", "RAMP": "ramp",
    "SECONDS": "0.1", "sensor|mirror|forty|design": "design", "[DIR...]": "capture", "DIR": "film",
}  # fmt: skip
#: More words, to be fast and to need neither terminal nor page.
MORE = {
    "live": ["--headless", "--frames", "3", "--pixels", "96x72"],
    "design": ["--verify", "0", "--seeds", "1", "--frames", "12"],
    "start": ["--from", "camera"],
    "report": ["--full", "--correspondence", "c.npz", "--scene", "rig.toml"],
    "demo": ["--full", "--scene", "rig.toml"],
    "calibrate": ["rest=rest.npz@mask.png", "--scene", "rig.toml", "--accept"],
    "reconstruct": ["--keep-rest"],
    "rig new": [
        word
        for each in QUESTIONS
        if each.only in ("", "monitor")
        for word in (each.flag, "monitor" if each.name == "kind" else each.default("monitor"))
    ],
}
#: Commands that take long by themselves.
SLOW = {"camera sync", "camera expose", "camera measure of many"}
#: Commands that cannot end well here: without a display, without somebody who answers.
UNABLE = {"start"}
WRITES = re.compile(r"to make|^Store |[Gg]ets |^File to write|^Also write|^Write |^Contacts and")


def walk(command: click.Command, name: str = "") -> Iterator[tuple[str, click.Command]]:
    """Every command that runs, by its full name."""
    if isinstance(command, click.Group):
        context = click.Context(command)
        for each in command.list_commands(context):
            inner = command.get_command(context, each)
            assert inner is not None
            yield from walk(inner, f"{name} {each}".strip())
    else:
        yield name, command


COMMANDS = dict(walk(app))
#: Commands of many captures have a second form.
MANY = " of many"
CALLS = [*COMMANDS, *(f"{name}{MANY}" for name, command in COMMANDS.items() if isinstance(command, Many))]


def is_output(parameter: click.Parameter) -> bool:
    """By its words, not by its type: one that has another type is an output too."""
    said = getattr(parameter, "help", "") or ""
    return isinstance(parameter.type, click.Path) and (
        parameter.name in ("out", "files") or bool(WRITES.search(said))
    )


def held() -> dict[str, str]:
    """Every file of the working folder with a hash of its content."""
    files = (path for path in Path().rglob("*") if path.is_file() and not path.is_symlink())
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@dataclass(frozen=True)
class Call:
    """A command with its inputs, of two captures where many. outputs: by flag."""

    title: str
    command: click.Command
    words: list[str]
    outputs: dict[str, click.Parameter]
    many: bool

    @classmethod
    def of(cls, name: str) -> "Call":
        many, name = name.endswith(MANY), name.removesuffix(MANY)
        command, words = COMMANDS[name], list[str]()
        outputs = {each.opts[0]: each for each in command.params if is_output(each)}
        if many:
            outputs = {flag: each for flag, each in outputs.items() if flag in ("--out", "--save-profile")}
        for each in command.params:
            taken = isinstance(command, Many) and each.name == command.captures
            if not is_output(each) and (each.required or taken):
                value = GIVEN[str(each.metavar)]
                values = [value, f"other/{value}"] if many and taken else [value]
                words += values if isinstance(each, click.Argument) else [each.opts[0], *values]
        more = [] if many else MORE.get(name, [])
        sized = any(isinstance(each.type, Shape) and each.type.least == 8 for each in command.params)
        words += [*(SIZE if sized and "--keep-rest" not in more else ()), *more]
        return cls(name, command, words, outputs, many)

    def run(self, values: Mapping[str, str]) -> int:
        words = [*self.title.split(), *self.words]
        needed = {
            flag: self.name(flag, f"needed{flag}") for flag, each in self.outputs.items() if each.required
        }
        for flag, value in (needed | dict(values)).items():
            words += [value] if isinstance(self.outputs[flag], click.Argument) else [flag, value]
        return run(words)

    def is_folder(self, flag: str) -> bool:
        """Whether an output is a folder."""
        return (flag == "--out" and self.many) or "DIR" in str(self.outputs[flag].metavar)

    def name(self, flag: str, stem: str) -> str:
        """A name for an output, with a suffix that it may have."""
        if self.is_folder(flag):
            return stem
        suffixes = getattr(self.outputs[flag].type, "suffixes", None)
        return stem + (".npz" if suffixes is None or ".npz" in suffixes else suffixes[0])

    @property
    def promised(self) -> set[str]:
        """The rig's file, where a command keeps its result in it: by its help."""
        said = [str(getattr(each, "help", "")) for each in (self.command, *self.command.params)]
        kept = re.search(
            r"RIG.toml gets|result\s+is stored|writes RIG.toml|that of --rig|with the rig RIG.toml",
            " ".join(said),
        )
        return {"rig.toml"} if kept else set()

    def inputs(self) -> tuple[list[str], list[str]]:
        """Files and folders among the words, with some files of these folders."""
        values = (word.partition("=")[2] or word for word in self.words)
        named = [part for value in values for part in value.split("@")]
        folders = [name for name in named if Path(name).is_dir()]
        inside = ("capture.toml", "frames/000.png", "truth.npz", "scene.toml", "log.jsonl")
        files = [f"{folder}/{name}" for folder in folders for name in inside if Path(folder, name).is_file()]
        return list(dict.fromkeys([name for name in named if Path(name).is_file()] + files)), folders


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Inputs of every kind, small."""
    folder = tmp_path_factory.mktemp("world")
    before = Path.cwd()
    os.chdir(folder)
    try:
        simulate = ["simulate", "--scene", "prism48", *SIZE, "--noise", "1", "--renderer", "numpy"]
        assert run([*simulate, "--dent", "gaussian:peak=.2,sigma=6", "--out", "capture"]) == 0
        assert run([*simulate, "--sequence", "ramp", "--out", "ramp"]) == 0
        assert run([*simulate, "--dent", "flat", "--seed", "1", "--out", "rest"]) == 0
        text = re.sub(r"(?m)^\[dent(.|\n)*?(?=^\[|\Z)", "", Path("capture/scene.toml").read_text())
        text = text.replace("exact = true\n", "")
        Path("rig.toml").write_text(text + '\n[devices]\ncamera = "virtual"\ndisplay = "virtual"\n')
        assert run(["decode", "capture", "--out", "c.npz"]) == 0
        assert run(["decode", "rest", "--out", "rest.npz"]) == 0
        cv2.imwrite("mask.png", np.full((24, 32), 255, np.uint8))
        assert run(["reconstruct", "c.npz", "--scene", "rig.toml", "--out", "h.npz"]) == 0
        assert (
            run(["camera", "measure", "--rig", "rig.toml", "--frames-only", "--keep", "--out", "taken"]) == 0
        )
        Path("taken.recording").rename("film")
        Path("other").mkdir()
        shutil.copy("c.npz", "other")
        shutil.copytree("capture", "other/capture")
    finally:
        os.chdir(before)
    return folder


@pytest.fixture
def restore(world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Makes the inputs anew in the working folder; nobody is at the terminal."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    monkeypatch.setattr("optolever.cli.rig.start.Interviewer.pick", Mock(side_effect=click.Abort))

    def restored() -> None:
        for path in folder.iterdir():
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
        shutil.copytree(world, folder, dirs_exist_ok=True)

    restored()
    return restored


@pytest.mark.parametrize("amid", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", CALLS)
def test_inputs_stay(name: str, amid: bool, restore: Callable[[], None]) -> None:
    """With an output on them, above or below them, on a link to the first or the last of the files (amid: on
    a link to one of the others)."""
    call = Call.of(name)
    files, folders = call.inputs()
    for flag in call.outputs:
        places = [] if amid else ["."]
        for k, folder in enumerate([] if amid else folders):
            places += [folder, f"{flag}{k}", f"{folder}/below", f"{folder}/frames"]
        for k, file in enumerate([] if call.is_folder(flag) else files):
            linked = (call.name(flag, f"{kind}{flag}{k}") for kind in ("soft", "hard"))
            places += [] if amid else [file]
            places += [] if (k in (0, len(files) - 1)) == amid else linked

        def inputs(flag: str = flag, places: list[str] = places) -> dict[str, str]:
            restore()
            for place in places:
                folder, file = (
                    re.fullmatch(rf"{flag}(\d)", place),
                    re.fullmatch(rf"(.{{4}}){flag}(\d).*", place),
                )
                if folder:
                    Path(place).symlink_to(folders[int(folder[1])])
                elif file and file[1] == "hard":
                    os.link(files[int(file[2])], place)
                elif file:
                    Path(place).symlink_to(files[int(file[2])])
            return held()

        before = inputs()
        for place in places:
            code = call.run({flag: place})
            lost = before.items() - (now := held()).items()
            may = call.promised | {place if place.startswith("hard") else ""} if code == 0 else set()
            may |= (
                {place} if flag == "--save-profile" and place.endswith(("rig.toml", "scene.toml")) else set()
            )
            assert {path for path, _ in lost} <= may, f"{flag} {place}: exit {code}"
            before = inputs() if now != before else before


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=pytest.mark.slow) if each in SLOW else each for each in CALLS]
)
def test_files_of_others_stay(name: str, restore: Callable[[], None]) -> None:
    """A run shows which names it writes beside its options' ones; then each is another's file."""
    call = Call.of(name)
    values = {flag: call.name(flag, f"new/{flag.strip('-')}") for flag in call.outputs}
    Path("new").mkdir()
    before = held()
    assert (code := call.run(values)) == 0 or call.title in UNABLE
    made = held()
    assert {path for path, _ in before.items() - made.items()} <= call.promised
    beside = sorted(made.keys() - before.keys() - set(values.values()))
    for path in [path for path in beside if len(Path(path).parts) <= 3][:12]:
        restore()
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_text("of somebody else")
        before = held()
        code = call.run(values)
        lost = {one for one, _ in before.items() - held().items()}
        assert lost <= (call.promised if code == 0 else set()), f"{path}: exit {code}"
