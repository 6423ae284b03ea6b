"""Public names say what they are, and their examples hold."""

import doctest
import importlib
import inspect
from types import ModuleType

import pytest

from optolever.patterns import sequence, sequence_names, sequence_parameters

PARTS = (
    *("scene", "patterns", "projector", "camera", "decode", "reconstruct", "calibration", "live"),
    *("samples", "report", "design"),
)
FACES = [importlib.import_module(f"optolever.{part}") for part in PARTS]


@pytest.mark.parametrize("face", FACES, ids=PARTS)
def test_every_public_class_and_function_has_a_docstring(face: ModuleType) -> None:
    public = [getattr(face, name) for name in face.__all__]
    bare = [
        one.__name__ for one in public if inspect.isroutine(one) or inspect.isclass(one) if not one.__doc__
    ]
    assert not bare


@pytest.mark.parametrize("face", FACES, ids=PARTS)
def test_examples_hold(face: ModuleType) -> None:
    finder = doctest.DocTestFinder(recurse=False)
    runner = doctest.DocTestRunner()
    for name in face.__all__:
        for test in finder.find(getattr(face, name), name, globs={n: getattr(face, n) for n in face.__all__}):
            runner.run(test)
    assert runner.summarize(verbose=False).failed == 0


def test_help_names_every_parameter_of_every_code() -> None:
    text = inspect.getdoc(sequence) or ""
    rows = {line.split("|")[1]: line.split("|")[2] for line in text.splitlines() if line.startswith("| ")}
    for name in sequence_names():
        (row,) = [value for names, value in rows.items() if name in names.strip().split(", ")]
        for key, default in sequence_parameters(name).items():
            assert (key if default is None else f"{key}={default!r}") in row, f"{name}: {key}"
