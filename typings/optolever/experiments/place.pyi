from experiments.place import *
