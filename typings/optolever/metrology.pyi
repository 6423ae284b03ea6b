from metrology import *
