from experiments.images import *
