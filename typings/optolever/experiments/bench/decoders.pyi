from experiments.bench.decoders import *
