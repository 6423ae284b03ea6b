from live.single_shot import *
