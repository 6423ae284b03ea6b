from cli.printing import *
