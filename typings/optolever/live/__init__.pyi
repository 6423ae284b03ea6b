from live import *
