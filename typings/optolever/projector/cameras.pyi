from projector.cameras import *
