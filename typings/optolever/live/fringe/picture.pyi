from live.fringe.picture import *
