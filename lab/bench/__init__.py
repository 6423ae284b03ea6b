"""Benches of many methods, and on many machines."""
