"""Heights of single frames: an independent renderer, streams of all kinds, faults, figures beside their
limits."""
