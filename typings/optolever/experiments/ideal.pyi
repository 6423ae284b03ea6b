from experiments.ideal import *
