"""The one error that a user's input can cause."""

import errno
from pathlib import Path

__all__ = ["InputError", "damage_of", "reason_of", "require_file"]


class InputError(ValueError):
    """Input that cannot be used: one line that names the file, the field, the value and the limit.

    The command line prints it and exits with code 2.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


def require_file(path: str | Path) -> None:
    """InputError unless there is a file of that name."""
    if Path(path).is_dir():
        inside = sorted(
            each.name
            for each in Path(path).iterdir()
            if each.suffix in (".toml", ".npz") and each.name[0] != "."
        )[:4]
        cure = f"; it holds {', '.join(inside)}" if inside else ""
        cure += " (optolever decode makes an .npz of it)" if "capture.toml" in inside else ""
        raise InputError(f"{path}: is a folder, must be a file{cure}")
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")


def damage_of(error: BaseException) -> str:
    """The fault of a file, in words about files: exceptions of Python and of libraries are about their
    variables."""
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.object[error.start]:#04x} at {error.start} is no {error.encoding.upper()}"
    if isinstance(error, KeyError) and " " not in str(error.args[0]):
        return f"{error.args[0]} is missing or unknown"
    if isinstance(error, OSError) and error.strerror:
        return reason_of(error)
    return str(error) if isinstance(error, InputError) else "damaged, cut off, or of another kind"


def reason_of(error: OSError) -> str:
    """Why the system refused, in one phrase. Libraries hide a full disk in their own text."""
    text = error.strerror or str(error)
    full = error.errno in (errno.ENOSPC, errno.EDQUOT) or "No space left on device" in text
    return "The disk is full" if full else text
