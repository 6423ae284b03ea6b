from experiments.design.candidates import *
