from experiments.design.view import *
