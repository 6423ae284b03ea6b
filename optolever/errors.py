"""The one error that a user's input can cause."""

from pathlib import Path

__all__ = ["InputError", "require_file"]


class InputError(ValueError):
    """Input that cannot be used: one line that names the file, the field, the value and the limit.

    The command line prints it and exits with code 2.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


def require_file(path: str | Path) -> None:
    """InputError unless there is a file of that name."""
    if Path(path).is_dir():
        inside = sorted(each.name for each in Path(path).iterdir() if each.suffix in (".toml", ".npz"))[:4]
        cure = f"; it holds {', '.join(inside)}" if inside else ""
        raise InputError(f"{path}: is a folder, must be a file{cure}")
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
