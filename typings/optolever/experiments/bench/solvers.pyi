from experiments.bench.solvers import *
