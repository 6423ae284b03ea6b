"""The one error that a user's input can cause."""

__all__ = ["InputError"]


class InputError(ValueError):
    """Input that cannot be used: one line that names the file, the field, the value and the limit.

    The command line prints it and exits with code 2.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))
