"""Hard cases of decode and reconstruct, and a verdict for each."""
