from reconstruct.rig import *
