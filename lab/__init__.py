"""lab: measures and attacks optolever itself. It is not installed: `python -m lab NAME` from the root.

It may import every module of `optolever`; tests alone import it.

| file | holds |
|---|---|
| `program.py`, `commands/` | the program; one file a command, named as it |
| `figures/` | figures beside their limits |
| - `figures.py` | run_figures: the demo and its error bars |
| - `decode_speed.py` | the decoder's speed, OpenCV's on the same frames |
| - `chart.py` | error of codes against pictures and CPU time: two rigs, three conditions |
| - `solver_figures.py` | the solver's time |
| - `ideal.py` | codes by their definitions |
| - `batch.py` | many captures: two processes beside one |
| - `page.py`, `chart.py` | docs/benchmarks.md and its chart |
| - `contacts.py` | two contacts on a rig drawn from the priors, against their total sigma |
| - `exposures.py` | three patterns in a picture against the same in grey |
| - `elastic.py` | elastic contacts by kinds: force, depth, thickness |
| - `pressed.py` | dents of known pressure, by formulas that the fit does not use |
| - `house.py` | the source in figures: lines, constants |
| `calibration/` | what a calibration is worth |
| - `rigs.py`, `figures.py` | rigs with errors and captures on them; the figures |
| - `typed.py` | rigs that are not as typed: heights against their total sigma |
| `fuzz/` | the program on damaged inputs |
| - `fuzz.py`, `damage.py` | cases and their verdicts; the damage |
| `hardware/` | displays and cameras in simulated time |
| - `simulated.py`, `synchronisation.py` | the models; what is recovered of them, what is captured |
| `live/` | heights of single frames |
| - `colour.py` | u in red and v in blue beside the crossed fringe |
| - `world.py` | an independent renderer of dents |
| - `streams.py`, `figures.py` | eleven kinds of streams, faults; time, error and sigma |
| `judgements/` | false alarms and misses of every test |
| - `record.py` | a row, and tables of rows |
| - `decode.py`, `captures.py`, `faults.py` | drawn captures; their faults, which tests name them |
| - `heights.py` | captures of right and wrong rigs, which tests name them |
"""
