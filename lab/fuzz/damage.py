"""Files damaged at random: their bytes, or what they say, which stays readable and gets past the readers."""

import json
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from copy import deepcopy
from datetime import date
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from optolever.pictures import read_picture

#: TOML values, as text.
EXTREMES = (
    *("0", "-1", "1e308", "-1e308", "1e-308", "1e9", "nan", "inf", "65536", "65537", "20000", "0.5", "true"),
    *('"x"', '""', "[]", "{}", "[1, 2]", "99999999999999999999", '"\\u0000"', "1979-05-27"),
)
_VALUES = tuple(tomllib.loads(f"value = {text}")["value"] for text in EXTREMES)
#: By what part of itself a number is moved, a scale of a logarithm: a little, well, out of sight.
_SCALES = (1e-3, 0.3, 3.0)
#: Share of the damage that is done to bytes.
_BYTES = 0.2


def damage(rng: np.random.Generator, path: Path) -> None:
    """Damage a file of TOML, JSON lines, arrays, HDF5, text or a picture, or pictures in a folder."""
    ways = {".toml": _damage_toml, ".jsonl": _damage_lines, ".npz": _damage_npz, ".h5": _damage_hdf5}
    ways |= {".npy": _damage_npy, **dict.fromkeys((".csv", ".sdf", ".wft"), _damage_text)}
    ways |= dict.fromkeys((".zst", ".x3p", ".dat"), _damage_bytes)
    if path.is_dir():
        _damage_frames(rng, path)
    elif rng.random() < _BYTES:
        _damage_bytes(rng, path)
    else:
        ways.get(path.suffix, _damage_picture)(rng, path)


def _damage_frames(rng: np.random.Generator, folder: Path) -> None:
    """One frame, or all of them in the same way."""
    frames = sorted(folder.iterdir())
    seed = int(rng.integers(1 << 30))
    for frame in frames if rng.random() < 0.5 else [frames[int(rng.integers(len(frames)))]]:
        damage(np.random.default_rng(seed), frame)


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
    """Move, replace, exchange, drop or repeat values; what is written is TOML."""
    values = tomllib.loads(path.read_text(encoding="utf-8"))
    _damage_values(rng, values, _VALUES)
    path.write_text(tomli_w.dumps(values), encoding="utf-8")


def _damage_lines(rng: np.random.Generator, path: Path) -> None:
    """One of the lines of JSON; or two of them exchanged, one dropped, one repeated."""
    lines = path.read_text(encoding="utf-8").splitlines()
    i, j, way = int(rng.integers(len(lines))), int(rng.integers(len(lines))), rng.random()
    if way < 0.7:
        lines[i] = _damaged_json(rng, lines[i])
    elif way < 0.8:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i : i + 1] = [] if way < 0.9 else [lines[i]] * 2
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _damaged_json(rng: np.random.Generator, text: str) -> str:
    """Values as of TOML, and null."""
    holder = [json.loads(text)]
    plain = [each for each in _VALUES if not isinstance(each, date)]
    _damage_values(rng, holder, (*plain, None))
    return json.dumps(holder[0] if holder else None)


def _damage_text(rng: np.random.Generator, path: Path) -> None:
    """One of its numbers or words."""
    words = re.split(r"([\s,=]+)", path.read_text(encoding="ascii"))
    words[2 * int(rng.integers((len(words) + 1) // 2))] = str(rng.choice([*EXTREMES, ""]))
    path.write_text("".join(words), encoding="ascii")


def _damage_values(rng: np.random.Generator, values: Any, extremes: Sequence[Any]) -> None:
    """Move, replace, exchange, drop or repeat values of a tree of tables and lists."""
    for _ in range(rng.integers(1, 4)):
        if not (places := list(_places(values))):
            return
        holder, key = places[int(rng.integers(len(places)))]
        value, way = holder[key], rng.random()
        if way < 0.6 and isinstance(value, int | float):
            holder[key] = type(value)(value * float(np.exp(rng.choice(_SCALES) * rng.standard_normal())))
        elif way < 0.8:
            holder[key] = deepcopy(extremes[int(rng.integers(len(extremes)))])
        elif way < 0.9:
            other, name = places[int(rng.integers(len(places)))]
            holder[key] = deepcopy(other[name])  # a table is never its own part
        elif way < 0.95 or isinstance(holder, dict):
            del holder[key]
        else:
            holder.append(value)


def _places(values: Any) -> Iterator[tuple[Any, Any]]:
    """Every holder and key of a tree of tables and lists: its leaves, the last table of a list."""
    for key, value in values.items() if isinstance(values, dict) else enumerate(values):
        if isinstance(value, dict | list):
            yield from _places(value)
        if not isinstance(value, dict | list) or (isinstance(values, list) and key == len(values) - 1):
            yield values, key


def _damage_picture(rng: np.random.Generator, path: Path) -> None:
    """Write another picture: other values, size, depth or channels."""
    image = read_picture(path)
    changes: list[Callable[[], NDArray[Any]]] = [
        lambda: np.where(rng.random(image.shape) < 0.05, rng.integers(0, 256), image),
        lambda: np.full_like(image, rng.integers(0, 256)),
        lambda: image[:, ::-1] if rng.random() < 0.5 else image[: int(rng.integers(1, len(image)))],
        lambda: image.astype(np.uint16) * rng.integers(1, 258, dtype=np.uint16),
        lambda: np.dstack([image] * int(rng.choice([3, 4]))),
        lambda: image[:1, :1] if rng.random() < 0.5 else image.T,
    ]
    changed = np.ascontiguousarray(changes[rng.integers(len(changes))]())
    cv2.imwrite(str(path), changed if changed.dtype == np.uint16 else changed.astype(np.uint8))


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
    kinds = ["c16", "U8", "i1", "f2", "f4", "?"]
    others: list[Callable[[], NDArray[Any]]] = [
        lambda: value[:-1] if value.ndim else np.zeros(3),
        lambda: np.zeros((0, *value.shape[1:]), value.dtype),
        lambda: value.astype(rng.choice(kinds) if value.dtype.kind in "fiu" else "U8"),
        lambda: np.array("text") if rng.random() < 0.5 else np.zeros((2,) * 7),
        lambda: value[..., None],
    ]
    return others[way - 3]()


def _damage_npz(rng: np.random.Generator, path: Path) -> None:
    """One of the arrays, or leave one out."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = str(rng.choice(list(arrays)))
    value = arrays.pop(name)
    if value.dtype.kind == "U" and value.size and rng.random() < 0.8:
        lines = np.atleast_1d(value).tolist()
        with suppress(ValueError):  # words, no JSON
            i = int(rng.integers(len(lines)))
            lines[i] = _damaged_json(rng, lines[i])
        arrays[name] = np.array(lines if value.ndim else lines[0])
    elif rng.random() < 0.9:
        with np.errstate(all="ignore"):
            arrays[name] = _drawn(rng, value)
    np.savez(path, **arrays)


def _damage_npy(rng: np.random.Generator, path: Path) -> None:
    """Another array."""
    with np.errstate(all="ignore"):
        np.save(path, _drawn(rng, np.load(path)))


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
    """One of the fields: another array, text, or one that is said to be huge."""
    import h5py

    with h5py.File(path, "r+") as file:
        fields = file[_SOFAST]
        name = str(rng.choice(list(fields)))
        value = fields[name][()]
        del fields[name]
        if rng.random() < 0.3:
            huge = tuple(int(size) for size in rng.integers(1, 1 << 20, 3))
            fields.create_dataset(name, huge, "u1", chunks=(1, 1, 1))
        else:
            with np.errstate(all="ignore"):
                changed = _drawn(rng, value)
            fields[name] = changed if changed.dtype.kind != "U" else "text"
