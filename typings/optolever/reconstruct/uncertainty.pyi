from reconstruct.uncertainty import *
