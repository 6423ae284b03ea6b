"""Studies of `design`: against all candidates, and frames chosen one after the other."""
