from reconstruct.fields import *
