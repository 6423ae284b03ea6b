from samples.metrics import *
