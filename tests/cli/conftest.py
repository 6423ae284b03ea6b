"""The program, called as a user would, and captures to spoil."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from optolever.cli import run

SCENE = ["--scene", "paper-simulation", "--pixels", "96x96"]


@dataclass(frozen=True)
class Outcome:
    """What a run of the program left behind: stdout, stderr."""

    out: str
    err: str


Program = Callable[..., Outcome]
Refused = Callable[..., str]


@pytest.fixture
def optolever(capfd: pytest.CaptureFixture[str]) -> Program:
    """Run `optolever` with arguments, in this process; it must end with `code`."""

    def call(*args: str | Path, code: int = 0) -> Outcome:
        capfd.readouterr()
        ended = run([str(arg) for arg in args])
        streams = capfd.readouterr()
        assert ended == code, streams.err
        return Outcome(streams.out, streams.err)

    return call


@dataclass(frozen=True)
class Chain:
    """Files of one small run of the chain."""

    capture: Path
    correspondence: Path
    height: Path
    numbers: dict[str, dict[str, Any]]

    @property
    def solve(self) -> list[Path | str]:
        """The last command but for its outputs."""
        return ["reconstruct", self.correspondence, "--scene", self.capture / "scene.toml"]


@pytest.fixture(scope="session")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Chain:
    """capture -> decode -> reconstruct at 96 x 96, photon noise and one level of white noise."""
    folder = tmp_path_factory.mktemp("chain")
    files = Chain(folder / "capture", folder / "c.npz", folder / "h.npz", {})
    steps = {
        "simulate": [*SCENE, "--dent", "gaussian:peak=1.3,sigma=20", "--sequence", "gray+phase",
                    "--noise", "1", "--seed", "3", "--renderer", "numpy", "--out", files.capture],
        "decode": [files.capture, "--out", files.correspondence],
        "reconstruct": [files.correspondence, "--scene", files.capture / "scene.toml", "--out", files.height,
                        "--truth", files.capture / "truth.npz"],
    }  # fmt: skip
    for name, args in steps.items():
        report = folder / f"{name}.json"
        assert run([name, *map(str, args), "--json", str(report)]) == 0
        files.numbers[name] = json.loads(report.read_text())
    return files
