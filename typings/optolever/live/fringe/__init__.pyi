from live.fringe import *
