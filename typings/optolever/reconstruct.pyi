from reconstruct import *
