"""decode(): frames and their descriptions -> Correspondence; Decoder: many captures of one rig."""

from typing import Any

from .profile import RigProfile, Settings
from .records import Correspondence

__all__ = ["Decoder", "decode", "estimate_profile"]


def decode(frames: Any, sequence: Any, **options: Any) -> Correspondence:
    """Skeleton."""
    raise NotImplementedError


def estimate_profile(frames: Any, sequence: Any, settings: Settings | None = None, *, mask: Any = None) -> RigProfile:
    """Skeleton."""
    raise NotImplementedError


class Decoder:
    """Skeleton."""
