from reconstruct.contact import *
