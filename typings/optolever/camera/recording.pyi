from camera.recording import *
