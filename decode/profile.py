"""RigProfile: common properties of the captures of one rig, estimated once, applied to further ones."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays, together
from optolever.notices import Notice
from optolever.patterns import Sequence
from optolever.scene import rig_table, write_sections
from optolever.schema import built

from .codes.fringe import Misfit
from .codes.lookup import LookUp
from .correspondence import SharedNoise
from .effects import Effect
from .frames import Settings
from .noise import Noise

__all__ = ["AxisProfile", "Estimates", "RigProfile", "Sampled", "digest"]


class Sampled(NamedTuple):
    """Statistics of sample pixels while a profile holds: share without a flag; median chi2 per degree of
    freedom; median amplitude, levels."""

    good: float
    chi2: float
    amplitude: float


class AxisProfile(NamedTuple):
    """Of one axis: misfit of each fringe; deviation of a sample over the amplitude (close periods, else 0);
    variance of every place, px^2; optics of a look-up, None without one."""

    misfits: tuple[Misfit, ...]
    deviation: float
    variance: float
    look_up: LookUp | None = None


class Estimates(NamedTuple):
    """Of one capture: noise, axes, effects, noise that pixels have in common, statistics, notices."""

    noise: Noise
    axes: tuple[AxisProfile, ...]
    effects: tuple[Effect, ...]
    shared: SharedNoise | None
    sampled: Sampled
    notices: tuple[Notice, ...]


@dataclass(frozen=True, slots=True, eq=False)
class RigProfile:
    """Estimated by `estimate_profile`, or by a `Decoder` from its first capture.

    sequence   digest of the sequence that the estimates belong to
    shape      (H, W) of the frames, dtype: their kind
    clip       raw level at which samples saturate; rounding: variance by rounding, levels^2
    settings   parameters of the estimation
    """

    sequence: str
    shape: tuple[int, ...]
    dtype: str
    clip: float
    rounding: float
    settings: Settings
    estimates: Estimates

    def effects(self) -> tuple[Effect, ...]:
        """Table of the estimates."""
        noise, nan = self.estimates.noise, float("nan")
        rows = [
            Effect("read noise", noise.read2**0.5, noise.read2_sigma / (2 * noise.read2**0.5), "levels"),
            Effect("noise gain", noise.gain, noise.gain_sigma, "levels^2 per level"),
        ]
        scales = [misfit.scale for axis in self.estimates.axes for misfit in axis.misfits]
        if scales:
            rows.append(Effect("misfit of the fringes", max(scales) ** 0.5, nan, "of the noise"))
        return (*rows, *self.estimates.effects)

    def with_lag(self, share: float) -> Self:
        """The profile with a measured share of the frame before (`camera.Timing.lag`), where the
        frames gave no estimate; its sigma is unknown and counts as 0."""
        known = self.estimates.effects
        if not share or any(effect.name == "lag" for effect in known):
            return self
        effects = (*known, Effect("lag", share, 0.0, "of the frame before"))
        return replace(self, estimates=self.estimates._replace(effects=effects))

    def save(self, path: str | Path) -> None:
        """Write an .npz: arrays, and all other numbers as JSON; for a rig's TOML in its folder, and into the
        TOML its name, as file of [profile]."""
        file, arrays = Path(path), dict[str, NDArray[Any]]()
        text = json.dumps(_packed(self, "profile", arrays))
        with together():
            if file.suffix.lower() == ".toml":
                toml, file = file, file.with_suffix(".profile.npz")
                write_sections(toml, {"profile": {"file": file.name}})
            save_arrays(file, {"profile": np.array(text), **arrays})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what save() wrote, an .npz or a rig's TOML; InputError names the wrong file."""
        path = Path(path)
        if path.suffix.lower() == ".toml":
            section = rig_table(path).get("profile")
            name = section.get("file") if isinstance(section, Mapping) else None
            if not isinstance(name, str):
                raise InputError(f"{path}: [profile] must name a file; run `optolever decode --save-profile`")
            path = path.parent / name
        arrays = load_arrays(path, ("profile",), ("profile",))
        try:
            text = json.loads(arrays["profile"].item(), object_hook=lambda table: _whole(table, arrays))
            found: Self = built(cls, text, "profile")
        except (ValueError, RecursionError, InputError) as error:
            why = f": {error}" if isinstance(error, InputError) else ""
            raise InputError(f"{path}: no profile of this version{why}; estimate it again") from error
        return found


def digest(sequence: Sequence) -> str:
    """Hash of a sequence's content; its name does not count."""
    own = () if sequence.packing is None else (sequence.packing,)
    content = repr((sequence.frames, sequence.rows, sequence.cols, sequence.nominal, *own))
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def _packed(value: object, name: str, arrays: dict[str, NDArray[Any]]) -> object:
    """JSON form of a value; arrays and NumPy numbers go into `arrays` by their names."""
    if isinstance(value, np.ndarray | np.generic):
        arrays[name] = np.asarray(value)
        return {"array": name}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return {key: _packed(getattr(value, key), f"{name}.{key}", arrays) for key in value._fields}
    if is_dataclass(value):
        keys = [field.name for field in fields(value)]
        return {key: _packed(getattr(value, key), f"{name}.{key}", arrays) for key in keys}
    if isinstance(value, tuple):
        return [_packed(one, f"{name}.{i}", arrays) for i, one in enumerate(value)]
    return value


def _whole(table: dict[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Any:
    """A table of JSON, or the array that stands there."""
    return arrays.get(str(table["array"])) if set(table) == {"array"} else table
