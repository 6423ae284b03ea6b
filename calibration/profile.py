"""A decoder's profile of the rig, stored with it: `[profile]` in the rig's TOML names an .npz beside it."""

from collections.abc import Mapping
from pathlib import Path

from optolever.decode import RigProfile
from optolever.errors import InputError
from optolever.files import together
from optolever.scene import rig_table, write_sections

__all__ = ["load_profile", "store_profile"]


def store_profile(path: str | Path, profile: RigProfile) -> Path:
    """Write the profile to an .npz, or for a rig's TOML to an .npz in its folder and its name into the TOML;
    the .npz's path."""
    file = Path(path)
    if file.suffix.lower() != ".toml":
        profile.save(file)
        return file
    beside = file.with_suffix(".profile.npz")
    with together():
        profile.save(beside)
        write_sections(file, {"profile": {"file": beside.name}})
    return beside


def load_profile(path: str | Path) -> RigProfile:
    """The profile in an .npz, or in the file that a rig's TOML names in [profile]. InputError names the wrong
    file."""
    file = Path(path)
    if file.suffix.lower() != ".toml":
        return RigProfile.load(file)
    section = rig_table(file).get("profile")
    name = section.get("file") if isinstance(section, Mapping) else None
    if not isinstance(name, str):
        raise InputError(f"{file}: [profile] must name a file; run `optolever decode --save-profile`")
    return RigProfile.load(file.parent / name)
