"""The program on damaged inputs."""
