from design import *
