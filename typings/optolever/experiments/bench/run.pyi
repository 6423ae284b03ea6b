from experiments.bench.run import *
