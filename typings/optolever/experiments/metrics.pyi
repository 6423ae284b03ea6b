from experiments.metrics import *
