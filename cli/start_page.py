"""The page of `start`."""
