"""Heights of single frames: an independent renderer, eleven kinds of streams, faults, figures beside their
limits."""
