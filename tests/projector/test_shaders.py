"""Shader files: includes, flags, values, line numbers; and that a scene compiles only what it has."""

import moderngl
import pytest

from optolever.projector.shaders import ShaderError, ShaderSource, build_source, compile_program


@pytest.mark.parametrize(
    ("name", "flags", "values", "words"),
    [
        ("no-such.glsl", {}, {}, ("no-such.glsl", "does not exist", "trace.glsl")),
        ("footprint.glsl", {}, {}, ("footprint.glsl", "BLUR", "not given")),
        ("footprint.glsl", {"BLUR": False}, {}, ("SHARP_FLOOR", "not given")),
        ("screen.glsl", {"BLURR": True}, {}, ("BLURR", "screen.glsl")),
        ("screen.glsl", {}, {"QUADS": 1}, ("QUADS", "screen.glsl")),
    ],
)
def test_unknown_names_are_errors(
    name: str, flags: dict[str, bool], values: dict[str, object], words: tuple[str, ...]
) -> None:
    with pytest.raises(ShaderError) as caught:
        build_source(name, flags, values)
    for word in words:
        assert word in str(caught.value)


def test_driver_errors_name_file_and_line(gl: moderngl.Context) -> None:
    source = build_source(
        "look.glsl",
        {"BLUR": False, "BOTH": False, "MEAN": False, "ALONG_U": True},
        {"QUADS": 1, "SHARP_FLOOR": 0.001},
    )
    lines = source.text.splitlines()
    at = next(i for i, line in enumerate(lines) if "float share(" in line)
    broken = ShaderSource(
        "\n".join([*lines[:at], lines[at].replace("float share", "flaot share"), *lines[at + 1 :]]),
        source.files,
    )
    number = next(
        i for i, line in enumerate(build_lines("footprint.glsl"), start=1) if line.startswith("float share(")
    )
    with pytest.raises(ShaderError, match=rf"footprint\.glsl:{number}\b"):
        compile_program(gl, broken)


def build_lines(name: str) -> list[str]:
    """The lines of a shader file."""
    from importlib.resources import files

    return (files("optolever.projector") / "shaders" / name).read_text().splitlines()


def test_locate_understands_other_drivers() -> None:
    source = ShaderSource("", ("look.glsl", "footprint.glsl"))
    assert source.locate("1(12) : error C1503") == "footprint.glsl:12 : error C1503"
    assert source.locate("ERROR: 0:7: 'x'") == "ERROR: look.glsl:7: 'x'"
    assert source.locate("9:7(3): error") == "9:7(3): error"
