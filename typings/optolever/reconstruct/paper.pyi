from reconstruct.paper import *
