from reconstruct.solver import *
