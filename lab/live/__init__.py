"""Heights of single frames: an independent renderer, twelve kinds of streams, faults, figures beside their
limits."""
