"""Shaders are files in `shaders/`, with features and constants defined for GLSL's preprocessor.

`#include "name.glsl"` inserts a file. `#line` directives number the lines by file, and `compile_program` puts
the file names back into driver errors.
"""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files

import moderngl

__all__ = ["ShaderError", "compile_program", "source"]

_INCLUDE = re.compile(r'^\s*#include "(.+)"$')
# Mesa "0:15(10): error", NVIDIA "0(15) : error", Intel/Apple "ERROR: 0:15:"
_LOCATION = re.compile(r"\b(\d+)(?::(\d+)\(\d+\)|\((\d+)\)|:(\d+))(?=\s*:)")


class ShaderError(RuntimeError):
    """A flag that no shader tests, or a program that the driver refuses."""


@cache
def _files() -> dict[str, list[str]]:
    """Lines of every shader file; a file's number in `#line` is its place."""
    folder = files(__package__) / "shaders"
    texts = {item.name: item.read_text(encoding="utf-8") for item in folder.iterdir()}
    return {name: texts[name].splitlines() for name in sorted(texts)}


def source(name: str, flags: Mapping[str, bool] | None = None, **values: float) -> str:
    """GLSL of shader file `name`; flags: feature -> on or off, all that it tests; values: constants."""
    body = list(_expanded(name))
    tested = set(re.findall(r"^\s*#ifn?def (\w+)", "\n".join(body), re.MULTILINE))
    if unknown := tested - (flags or {}).keys():
        raise ShaderError(f"{name}: flag {min(unknown)} is not given")
    given = {key: "" for key, on in (flags or {}).items() if on} | {key: str(v) for key, v in values.items()}
    return "\n".join(
        ["#version 330 core", *(f"#define {key} {text}" for key, text in given.items()), *body, ""]
    )


def compile_program(ctx: moderngl.Context, fragment: str) -> moderngl.Program:
    """Compile a fragment shader for a covered target. ShaderError: file, line."""
    try:
        return ctx.program(vertex_shader=source("screen.glsl"), fragment_shader=fragment)
    except moderngl.Error as error:
        raise ShaderError(_LOCATION.sub(_located, str(error))) from error


def _located(match: re.Match[str]) -> str:
    """A place in a driver's message with its file's name."""
    names, number = list(_files()), int(match[1])
    line = next(group for group in match.groups()[1:] if group)
    return f"{names[number]}:{line}" if number < len(names) else match[0]


def _expanded(name: str) -> Iterator[str]:
    number = list(_files()).index(name)
    yield f"#line 1 {number}"
    for at, line in enumerate(_files()[name], start=1):
        if include := _INCLUDE.match(line):
            yield from _expanded(include[1])
            yield f"#line {at + 1} {number}"
        else:
            yield line
