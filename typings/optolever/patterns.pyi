from patterns import *
