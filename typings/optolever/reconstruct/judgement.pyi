from reconstruct.judgement import *
