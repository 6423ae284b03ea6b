from cli.outputs import *
