from reconstruct.outputs import *
