from cli.rig import *
