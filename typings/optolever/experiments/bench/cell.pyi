from experiments.bench.cell import *
