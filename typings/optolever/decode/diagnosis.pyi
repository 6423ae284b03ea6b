from decode.diagnosis import *
