from decode.single_shot import *
