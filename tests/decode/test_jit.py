"""How kernels are compiled."""

import gc
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from optolever.decode import decode, jit
from optolever.decode.jit import apart_kernel, fast_kernel, leaf_kernel, outer_kernel
from optolever.errors import InputError
from optolever.patterns import sequence


@pytest.mark.parametrize("decorate", [leaf_kernel, fast_kernel, apart_kernel])
def test_parts_of_kernels_run_in_their_callers_only(decorate):
    @decorate
    def double(values, out):
        for x in range(len(values)):
            out[x] = 2 * values[x]

    @njit
    def caller(values, out):
        double(values, out)

    out = np.zeros(40, np.float32)
    caller(np.arange(40, dtype=np.float32), out)
    assert np.array_equal(out, 2 * np.arange(40))
    # numba's C code would call what is not there
    for _ in range(2):
        with pytest.raises(TypeError, match="double is compiled into its callers"):
            double(out, out)


def test_outer_kernels_are_called_from_python():
    @outer_kernel
    def total(values):
        left = 0.0
        for x in values:
            left += x
        return left

    assert total(np.arange(4.0)) == 6


@pytest.mark.parametrize("on", [True, False])
def test_search_for_garbage_goes_on_as_before(on):
    """After a decode, and after one that fails."""
    assert gc.isenabled()
    try:
        if not on:
            gc.disable()
        shown = sequence("phase", 12, 16, periods=(24.0,))
        decode(np.full((len(shown), 5, 6), 20, np.uint8), shown)
        assert gc.isenabled() == on
        with pytest.raises(InputError):
            decode(np.zeros((1, 5, 6), np.uint8), shown)
        assert gc.isenabled() == on
    finally:
        gc.enable()


@pytest.mark.parametrize("elsewhere", [False, True])
def test_cached_code_goes_with_the_sources(elsewhere, tmp_path):
    """A part's change drops the code of kernels that it was compiled into, wherever numba keeps that."""
    source = Path(jit.__file__).parent
    house = tmp_path / "house"
    shutil.copytree(source, house / "decode", ignore=shutil.ignore_patterns("__pycache__"))
    part = house / "decode" / "part_kernels.py"
    (house / "decode" / "__init__.py").write_text("")
    (house / "decode" / "whole_kernels.py").write_text(
        "from .jit import outer_kernel\nfrom .part_kernels import part\n\n\n"
        "@outer_kernel\ndef whole():\n    return part()\n"
    )
    environment = os.environ | {"PYTHONPATH": str(house), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    if elsewhere:
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
    call = "from decode.whole_kernels import whole; print(whole(), sum(whole.stats.cache_hits.values()))"

    def told() -> str:
        command = [sys.executable, "-c", call]
        run = subprocess.run(
            command, capture_output=True, text=True, env=environment, cwd=tmp_path, check=True
        )
        return run.stdout.strip()

    def write(answer: int) -> None:
        part.write_text(f"from .jit import leaf_kernel\n\n\n@leaf_kernel\ndef part():\n    return {answer}\n")

    write(10)
    assert [told(), told()] == ["10 0", "10 1"]
    write(200)
    assert [told(), told()] == ["200 0", "200 1"]


_SEEN = """
import numpy as np
from optolever.decode import block_kernels, cell_kernels, decode, fringe_kernels, neighbour_kernels
from optolever.decode.jit import _ASKED, asked_types
from optolever.experiments import decode_speed
from optolever.patterns import sequence

size = 96, 128
_, phase, _, fringes = decode_speed._phase_frames(size)
gray = sequence("gray", *size)
bits = decode_speed._shoot(gray.frames, *decode_speed._place(size))
"""


def _told(script: str, **environment: str) -> list[str]:
    command = [sys.executable, "-c", _SEEN + script]
    own = os.environ | environment
    run = subprocess.run(command, capture_output=True, text=True, env=own)
    assert run.returncode == 0, run.stderr
    return run.stdout.split()


def test_kernels_are_asked_for_as_they_say():
    """What a cold start compiles ahead of time is what decodes call, with these types and no others."""
    script = """
decode(fringes, phase)
decode(bits, gray)
for use in ("fringes", "code", "code alone", "all"):
    for one in _ASKED[use]:
        assert list(one.overloads) == [asked_types(one)], (one, list(one.overloads))
    print(use, len(_ASKED[use]))
"""
    assert _told(script) == ["fringes", "8", "code", "1", "code", "alone", "1", "all", "3"]


def test_images_of_any_width_are_decoded_by_the_same_kernels():
    """Rows that are no whole vectors once were another kind of array: compiled again, and slower."""
    script = """
parts = fringe_kernels.fringes_of_tile.dispatcher, neighbour_kernels.near_block.dispatcher
kernels = [block_kernels.decode_blocks, *parts]
for width in (128, 131):
    _, phase, _, fringes = decode_speed._phase_frames((96, width))
    decode(fringes, phase)
    print([len(one.overloads) for one in kernels])
"""
    first, second = " ".join(_told(script)).split("] [")
    assert first.strip("[]") == second.strip("[]") == "1, 1, 1"


def test_a_cold_start_takes_two_processes_and_tells_the_same(tmp_path):
    script = """
found = decode(bits, gray)
parts = cell_kernels.code_of_tile.dispatcher, neighbour_kernels.near_block.dispatcher
kernels = [block_kernels.decode_blocks, *parts, *_ASKED["code"], *_ASKED["all"]]
print(sum(sum(one.stats.cache_hits.values()) for one in kernels), np.nansum(found.u), np.sum(found.flags))
"""
    hits, *cold = _told(script, NUMBA_CACHE_DIR=str(tmp_path), OPTOLEVER_THREADS="2")
    assert int(hits) > 0  # the other process made them
    _, *warm = _told(script)
    assert cold == warm
