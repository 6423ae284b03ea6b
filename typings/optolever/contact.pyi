from contact import *
