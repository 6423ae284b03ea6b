from live.serve import *
