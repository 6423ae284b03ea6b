from camera.cameras import *
