"""Heights of single frames: an independent renderer, drawn streams with faults, figures beside their
limits."""
