from design.view import *
