from decode.effects import *
