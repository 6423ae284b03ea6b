from projector import *
