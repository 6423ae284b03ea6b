from decode.profile import *
