"""False alarms and misses of the program's judgements, counted.

| file | holds |
|---|---|
| `record.py` | a row, and tables of rows |
| `decode.py`, `captures.py`, `faults.py` | tests of captures: drawn ones; faults of frames and descriptions |
| `heights.py` | captures of right and wrong rigs, and which tests name them |
"""
