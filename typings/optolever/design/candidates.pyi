from design.candidates import *
