from experiments.bench import *
