from experiments.bench.worker import *
