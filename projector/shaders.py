"""Shaders are files in `shaders/`: includes, flags and constants are resolved before the driver sees them.

Directives of these files (one a line):

    #include "name.glsl"      once per program; a second include of the same file is omitted
    #ifdef FLAG / #ifndef FLAG / #else / #endif
                              FLAG is a feature of the program; code of a feature that is off is removed
    $NAME                     replaced by the value of the define NAME

`#line` directives number the lines by file, and `compile_program` puts the file names back into driver
errors.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import moderngl

__all__ = ["ShaderError", "ShaderSource", "build_source", "compile_program"]

_VERSION = "#version 330 core"
_DIRECTIVE = re.compile(r"^\s*#(include|ifdef|ifndef|else|endif)\b\s*(.*?)\s*$")
_VARIABLE = re.compile(r"\$(\w+)")
# Mesa "0:15(10): error", NVIDIA "0(15) : error", Intel/Apple "ERROR: 0:15:"
_LOCATION = re.compile(r"\b(\d+)(?::(\d+)\(\d+\)|\((\d+)\)|:(\d+))(?=\s*:)")


class ShaderError(RuntimeError):
    """A shader file, flag or constant that does not exist, or a program that the driver refuses."""


@dataclass(frozen=True, slots=True)
class ShaderSource:
    """GLSL as the driver gets it, and the files it came from in the order of their `#line` numbers."""

    text: str
    files: tuple[str, ...]

    def locate(self, message: str) -> str:
        """The driver's message with file names in place of source numbers."""

        def name(match: re.Match[str]) -> str:
            number = int(match[1])
            line = next(group for group in match.groups()[1:] if group)
            return f"{self.files[number]}:{line}" if number < len(self.files) else match[0]

        return _LOCATION.sub(name, message)


def build_source(
    name: str, flags: Mapping[str, bool] | None = None, values: Mapping[str, object] | None = None
) -> ShaderSource:
    """The source of shader file `name`.

    flags: feature -> on or off. A flag that the files test must be given, and one given must be tested by
    them. values: name -> text for `$name`, under the same rule. ShaderError names a violation.
    """
    builder = _Builder(dict(flags or {}), {key: str(value) for key, value in (values or {}).items()})
    lines = [_VERSION, *builder.expand(name)]
    unused = sorted((builder.flags.keys() | builder.values.keys()) - builder.used)
    if unused:
        raise ShaderError(f"{name}: no flag or value named {unused[0]} in {', '.join(builder.files)}")
    return ShaderSource("\n".join(lines) + "\n", tuple(builder.files))


def compile_program(
    ctx: moderngl.Context, fragment: ShaderSource, vertex: str = "screen.glsl"
) -> moderngl.Program:
    """Compile a fragment shader with the vertex shader that covers the target. ShaderError: file, line."""
    try:
        return ctx.program(vertex_shader=build_source(vertex).text, fragment_shader=fragment.text)
    except moderngl.Error as error:
        raise ShaderError(fragment.locate(str(error))) from error


@cache
def _read(name: str) -> str:
    path = files(__package__) / "shaders" / name
    if not path.is_file():
        known = sorted(item.name for item in (files(__package__) / "shaders").iterdir())
        raise ShaderError(f"shader file {name!r} does not exist (there are {', '.join(known)})")
    return path.read_text(encoding="utf-8")


class _Builder:
    """Expands one program's files; keeps which files, flags and values were met."""

    def __init__(self, flags: dict[str, bool], values: dict[str, str]) -> None:
        self.flags, self.values = flags, values
        self.files: list[str] = []
        self.used: set[str] = set()

    def expand(self, name: str) -> list[str]:
        number = len(self.files)
        self.files.append(name)
        out = [f"#line 1 {number}"]
        active = [True]
        for at, line in enumerate(_read(name).splitlines(), start=1):
            directive = _DIRECTIVE.match(line)
            if directive is None:
                if all(active):
                    out.append(self._substitute(line, name))
                continue
            word, argument = directive.groups()
            if word == "include":
                if all(active):
                    out += self._include(argument.strip('"'))
            else:
                self._switch(word, argument, active, f"{name}:{at}")
            out.append(f"#line {at + 1} {number}")
        if len(active) != 1:
            raise ShaderError(f"{name}: #ifdef without #endif")
        return out

    def _include(self, name: str) -> list[str]:
        return [] if name in self.files else self.expand(name)

    def _switch(self, word: str, argument: str, active: list[bool], where: str) -> None:
        if word in ("ifdef", "ifndef"):
            if argument not in self.flags:
                raise ShaderError(f"{where}: flag {argument} is not given")
            self.used.add(argument)
            active.append(self.flags[argument] == (word == "ifdef"))
        elif len(active) == 1:
            raise ShaderError(f"{where}: #{word} without #ifdef")
        elif word == "else":
            active[-1] = not active[-1]
        else:
            active.pop()

    def _substitute(self, line: str, name: str) -> str:
        def value(match: re.Match[str]) -> str:
            if match[1] not in self.values:
                raise ShaderError(f"{name}: value ${match[1]} is not given")
            self.used.add(match[1])
            return self.values[match[1]]

        return _VARIABLE.sub(value, line)
