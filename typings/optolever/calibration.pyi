from calibration import *
