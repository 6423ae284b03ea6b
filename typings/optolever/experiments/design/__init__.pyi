from experiments.design import *
