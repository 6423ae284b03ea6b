from experiments.bench.measures import *
