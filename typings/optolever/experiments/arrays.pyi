from experiments.arrays import *
