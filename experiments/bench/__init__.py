"""bench: speed against error, hard cases, sweeps."""

__all__: list[str] = []
