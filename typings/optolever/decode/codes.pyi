from decode.codes import *
