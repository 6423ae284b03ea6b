"""What a calibration is worth, by simulated rigs."""
