from decode.checks import *
