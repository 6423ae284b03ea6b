from experiments.timing import *
