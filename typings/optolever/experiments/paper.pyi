from experiments.paper import *
