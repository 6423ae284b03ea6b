"""Files damaged at random: their bytes, or what they say, which stays readable and gets past the readers."""

import re
import tomllib
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from optolever.pictures import read_picture

EXTREMES = (
    *("0", "-1", "1e308", "-1e308", "1e-308", "nan", "inf", "65536", "65537", "20000", "0.5", "true"),
    *('"x"', '""', "[]", "{}", "[1, 2]", "99999999999999999999", "\\u0000", "1979-05-27"),
)
_NUMBERS = (0.0, -1.0, 1e-9, 1e9, 1e308, float("nan"), float("inf"), 65536.0, 65537.0)
#: By what part of itself a number is moved, a scale of a logarithm: a little, well, out of sight.
_SCALES = (1e-3, 0.3, 3.0)


def damage(rng: np.random.Generator, path: Path) -> None:
    """Damage a file of TOML, arrays, HDF5 or a picture, or pictures in a folder, as suits it."""
    ways = {"": _damage_frames, ".toml": _damage_toml, ".npz": _damage_npz, ".h5": _damage_hdf5}
    ways.get(path.suffix, _damage_picture)(rng, path)


def _damage_bytes(rng: np.random.Generator, path: Path) -> None:
    """Flip, cut, repeat or blank bytes of a file."""
    data = bytearray(path.read_bytes())
    at, count = int(rng.integers(len(data))), int(rng.integers(1, 64))
    way = rng.integers(4)
    if way == 0:
        for place in rng.integers(len(data), size=count):
            data[place] ^= 1 << int(rng.integers(8))
    elif way == 1:
        del data[at:]
    elif way == 2:
        data[at:at] = data[at : at + count]
    else:
        data[at : at + count] = bytes(len(data[at : at + count]))
    path.write_bytes(data)


def _damage_toml(rng: np.random.Generator, path: Path) -> None:
    """Damage bytes, lines or (most often) values."""
    ways: list[Callable[[np.random.Generator, Path], None]] = [_damage_bytes, _damage_lines, _damage_values]
    ways[int(rng.choice(3, p=(0.1, 0.3, 0.6)))](rng, path)


def _damage_values(rng: np.random.Generator, path: Path) -> None:
    """Move, replace, drop, exchange or repeat values; what is written is TOML."""
    values = tomllib.loads(path.read_text(encoding="utf-8"))
    for _ in range(rng.integers(1, 4)):
        places = list(_places(values))
        holder, key = places[int(rng.integers(len(places)))]
        value, way = holder[key], rng.random()
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if way < 0.7 and number:
            holder[key] = _moved(rng, value)
        elif way < 0.8 and number:
            holder[key] = float(rng.choice(_NUMBERS))
        elif way < 0.9:
            other, name = places[int(rng.integers(len(places)))]
            holder[key] = deepcopy(other[name])  # a table is never its own part
        elif way < 0.95:
            del holder[key]
        elif isinstance(holder, list):
            holder.append(value)
        elif isinstance(value, bool):
            holder[key] = not value
    path.write_text(tomli_w.dumps(values), encoding="utf-8")


def _places(values: Any) -> Any:
    """Every holder and key of a tree of tables and lists: its leaves, and now and then what holds them."""
    pairs = list(values.items()) if isinstance(values, dict) else list(enumerate(values))
    for key, value in pairs:
        if isinstance(value, dict | list):
            yield from _places(value)
            if isinstance(value, list) and value and isinstance(value[0], dict):
                yield value, len(value) - 1
        else:
            yield values, key


def _moved(rng: np.random.Generator, value: float) -> float:
    moved: float = (
        value * float(np.exp(rng.choice(_SCALES) * rng.standard_normal())) * (-1) ** (rng.random() < 0.05)
    )
    return round(moved) if isinstance(value, int) else moved


def _damage_lines(rng: np.random.Generator, path: Path) -> None:
    """Replace values by what is none, drop or repeat lines."""
    lines = path.read_text(encoding="utf-8").splitlines()
    for _ in range(rng.integers(1, 3)):
        filled = [i for i, line in enumerate(lines) if line.strip()]
        i, way = int(rng.choice(filled)), rng.random()
        if way < 0.7 and "=" in lines[i]:
            key, _, value = lines[i].partition("=")
            parts = list(re.finditer(r"-?[\d.]+(e-?\d+)?|\w+", value))
            extreme = str(rng.choice(EXTREMES))
            if parts and rng.random() < 0.7:
                part = parts[int(rng.integers(len(parts)))]
                extreme = value[: part.start()].strip() + extreme + value[part.end() :]
            lines[i] = f"{key}= {extreme}"
        elif way < 0.85:
            lines[i] = ""
        else:
            lines.insert(i, lines[i])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _damage_picture(rng: np.random.Generator, path: Path) -> None:
    """Damage bytes, or (more often) write another picture: other values, size, depth or channels."""
    way = rng.integers(8)
    if way < 2:
        _damage_bytes(rng, path)
        return
    image = read_picture(path)
    changes: list[Callable[[NDArray[Any]], NDArray[Any]]] = [
        lambda image: np.where(rng.random(image.shape) < 0.05, rng.integers(0, 256), image),
        lambda image: np.full_like(image, rng.integers(0, 256)),
        lambda image: image[:, ::-1] if rng.random() < 0.5 else image[: int(rng.integers(1, len(image)))],
        lambda image: image.astype(np.uint16) * rng.integers(1, 258, dtype=np.uint16),
        lambda image: np.dstack([image] * int(rng.choice([2, 3, 4]))),
        lambda image: image[:1, :1] if rng.random() < 0.5 else image.T,
    ]
    image = np.ascontiguousarray(changes[way - 2](image))
    channels = 1 if image.ndim == 2 else image.shape[2]
    if channels == 2:  # no writer of pictures takes two
        image = image[..., 0]
    cv2.imwrite(str(path), image if image.dtype == np.uint16 else image.astype(np.uint8))


def _damage_frames(rng: np.random.Generator, folder: Path) -> None:
    """One frame, or all of them in the same way."""
    frames = sorted(folder.iterdir())
    state = rng.bit_generator.state
    for frame in frames if rng.random() < 0.5 else [frames[int(rng.integers(len(frames)))]]:
        rng.bit_generator.state = state
        _damage_picture(rng, frame)


def _drawn(rng: np.random.Generator, value: NDArray[Any]) -> NDArray[Any]:
    """An array with other values, another type or another shape."""
    way, flat = rng.integers(8), np.array(value).ravel()
    if way in (0, 1, 2) and flat.size and value.dtype.kind in "fiu":
        some = rng.random(flat.size) < rng.choice([0.01, 0.3])
        if value.dtype.kind == "f" and way == 0:
            flat[some] = rng.choice([np.nan, np.inf, -np.inf, 1e38, -1e6, 0.0, -1.0], some.sum())
        elif value.dtype.kind == "f":
            flat[some] *= np.exp(rng.choice(_SCALES) * rng.standard_normal(some.sum()))
        else:
            flat[some] = 0
        return flat.reshape(value.shape)
    if way == 3:
        return value[:-1] if value.ndim else np.zeros(3)
    if way == 4:
        return np.zeros((0, *value.shape[1:]), value.dtype)
    if way == 5:
        kind = rng.choice(["c16", "U8", "i1", "f2", "f4", "?"])
        return value.astype(kind) if value.dtype.kind in "fiu" else value
    if way == 6:
        return np.array("text") if rng.random() < 0.5 else np.zeros((2,) * 7)
    return value[..., None]


def _damage_npz(rng: np.random.Generator, path: Path) -> None:
    """Damage bytes, or (more often) one of the arrays, or leave one out."""
    if rng.random() < 0.2:
        _damage_bytes(rng, path)
        return
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = str(rng.choice(list(arrays)))
    if rng.random() < 0.1:
        del arrays[name]
    else:
        with np.errstate(all="ignore"):
            arrays[name] = _drawn(rng, arrays[name])
    np.savez(path, **arrays)


_SOFAST = "MeasurementSofastFringe"


def save_sofast(path: Path, frames: NDArray[Any]) -> None:
    """A measurement as SOFAST writes it, of the first eight of frames (N, H, W)."""
    import h5py

    one, images = np.ones(1), np.moveaxis(frames[:8], 0, -1)
    fields = {"fringe_images": images, "fringe_periods_x": one, "fringe_periods_y": one}
    with h5py.File(path, "w") as file:
        for name, value in (fields | {"mask_images": images[..., :2]}).items():
            file[f"{_SOFAST}/{name}"] = value


def _damage_hdf5(rng: np.random.Generator, path: Path) -> None:
    """Damage one of the fields: another array, text, or one that is said to be huge; or bytes; or both."""
    import h5py

    with h5py.File(path, "r+") as file:
        fields = file[_SOFAST]
        name = str(rng.choice([*fields, "none"]))
        if name != "none":
            value = fields[name][()]
            del fields[name]
            if rng.random() < 0.3:
                huge = tuple(int(size) for size in rng.integers(1, 1 << 20, 3))
                fields.create_dataset(name, huge, "u1", chunks=(1, 1, 1))
            else:
                with np.errstate(all="ignore"):
                    changed = _drawn(rng, value)
                fields[name] = changed if changed.dtype.kind != "U" else "text"
    if rng.random() < 0.3:
        _damage_bytes(rng, path)
