from live.rest import *
