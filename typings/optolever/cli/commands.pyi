from cli.commands import *
