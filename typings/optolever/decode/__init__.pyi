from decode import *
