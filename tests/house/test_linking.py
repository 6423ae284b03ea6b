"""Kernels that are compiled by themselves, in other processes, too, and linked."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit, typeof
from numba.core.errors import NumbaError

from optolever import elsewhere
from optolever.elsewhere import compile_all, is_kept
from optolever.linking import Linked, linking

Floats = np.ndarray[Any, np.dtype[np.float64]]


def linked() -> Linked:
    @njit(cache=True)
    def add(number: float, values: Floats) -> None:
        for x in range(len(values)):
            values[x] += number

    return Linked(add)


def test_a_linked_kernel_is_called_and_not_copied() -> None:
    part = linked()
    call = part.call

    @njit
    def caller(values: Floats) -> None:
        call((2.0, values))
        call((1, values))  # of a type of its own

    def parts(types: Any) -> list[tuple[Linked, Any]]:
        return [(part, (typeof(number), *types)) for number in (2.0, 1)]

    values = np.arange(5.0)
    linking(caller, parts)(values)
    assert np.array_equal(values, np.arange(5) + 3)
    assert len(part.dispatcher.overloads) == 2
    code = caller.inspect_llvm(caller.signatures[0])
    assert "fadd" not in code
    assert code.count("declare i32 @") >= 2


def test_arguments_that_nobody_linked_do_not_end_the_process() -> None:
    call = linked().call

    @njit
    def caller(values: Floats) -> None:
        call((2.0, values))

    with pytest.raises((TypeError, NumbaError), match="add is not linked for such arguments"):
        caller(np.zeros(3))


def kernels(count: int) -> list[Any]:
    def made() -> Any:
        @njit(cache=True)
        def double(value: float) -> float:
            return 2 * value

        return double

    return [made() for _ in range(count)]


@pytest.mark.skipif(os.name == "nt", reason="stand-ins are shell scripts")
def test_what_the_other_process_cannot_be_told_is_not_waited_for() -> None:
    class Untold:
        py_func = staticmethod(time.sleep)

    helper = elsewhere._Helper()
    helper.add([], (Untold(), (lambda: None,)))  # which cannot be pickled
    deadline = time.monotonic() + 60
    while helper._at is None and helper._thread.is_alive() and time.monotonic() < deadline:
        time.sleep(0.01)
    helper.wait()
    helper.end()
    assert not helper._thread.is_alive()


@pytest.mark.parametrize("fault", ["dies", "hangs", "is not there", "is no Python"])
def test_all_is_compiled_here_if_the_other_process_fails(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / ("editor" if fault == "is no Python" else "python")
    if fault in ("dies", "hangs"):
        program.write_text(f"#!/bin/sh\necho\n{'exec sleep 100' if fault == 'hangs' else ''}\n")
        program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    monkeypatch.setattr(elsewhere, "threads", lambda: 2)
    monkeypatch.setattr(elsewhere, "is_kept", lambda *_: False)
    monkeypatch.setattr(elsewhere, "_PATIENCE", 0.2)
    *some, last = kernels(4)
    types, usual = (typeof(1.0),), some[0].compile

    def late(signature: Any) -> None:
        time.sleep(0.3)  # so that the other process has begun
        usual(signature)

    some[0].compile = late
    compile_all([(one, types) for one in some], (last, types))
    for one in some:
        one.compile(types)  # what was left to it
    assert all(types in one.overloads for one in some)
    assert not last.overloads


@pytest.mark.parametrize("threads", [1, 2])
def test_what_another_process_compiles_is_taken_from_the_cache(threads: int, tmp_path: Path) -> None:
    """A second thread is worth a second process; it starts with the `last` one."""
    script = """
import time
from optolever import elsewhere
from optolever.decode.run_kernels import changes_down, large_variance
from optolever.decode.jit import asked_types

changes, variance = ((one, asked_types(one)) for one in (changes_down, large_variance))


class Slow:
    overloads = {}

    def compile(self, types):
        until = time.monotonic() + 60
        while threads > 1 and not all(elsewhere.is_kept(*task) for task in (changes, variance)):
            assert time.monotonic() < until
            time.sleep(0.05)


known = elsewhere.is_kept
elsewhere.is_kept = lambda one, types: not isinstance(one, Slow) and known(one, types)
elsewhere.compile_all([(Slow(), ()), variance], changes)
for one, types in (changes, variance):
    one.compile(types)
    print(sum(one.stats.cache_hits.values()), sum(one.stats.cache_misses.values()))
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "OPTOLEVER_THREADS": str(threads)}
    command = [sys.executable, "-c", f"threads = {threads}\n{script}"]
    run = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert run.stdout.split() == (["1", "0"] * 2 if threads == 2 else ["0", "1"] * 2), run.stderr


def test_what_is_kept_is_known(tmp_path: Path) -> None:
    (one,) = kernels(1)
    floats, ints = (typeof(1.0),), (typeof(1),)
    one.compile(floats)
    assert is_kept(one, floats)
    assert not is_kept(one, ints)
