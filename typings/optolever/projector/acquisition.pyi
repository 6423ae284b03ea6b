from projector.acquisition import *
