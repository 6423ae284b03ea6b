from cli.arguments import *
