"""Shader files: unknown names are errors, and a driver's errors point at the file and its line."""

from importlib.resources import files

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
    assert source.text.count("float share(") == 1
    broken = ShaderSource(source.text.replace("float share(", "flaot share("), source.files)
    file = (files("optolever.projector") / "shaders/footprint.glsl").read_text()
    number = 1 + file[: file.index("\nfloat share(") + 1].count("\n")
    with pytest.raises(ShaderError, match=rf"footprint\.glsl:{number}\b"):
        compile_program(gl, broken)


def test_locate_understands_other_drivers() -> None:
    source = ShaderSource("", ("look.glsl", "footprint.glsl"))
    assert source.locate("1(12) : error C1503") == "footprint.glsl:12 : error C1503"
    assert source.locate("ERROR: 0:7: 'x'") == "ERROR: look.glsl:7: 'x'"
    assert source.locate("9:7(3): error") == "9:7(3): error"
