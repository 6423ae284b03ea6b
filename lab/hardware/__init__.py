"""hardware: displays and cameras in simulated time. The map of its files is `lab`'s."""
