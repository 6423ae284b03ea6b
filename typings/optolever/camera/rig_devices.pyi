from camera.rig_devices import *
