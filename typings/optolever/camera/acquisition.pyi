from camera.acquisition import *
