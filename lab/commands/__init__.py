"""The commands of `python -m lab`: parse, call, print."""
