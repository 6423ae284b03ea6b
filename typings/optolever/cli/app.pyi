from cli.app import *
