"""What can be read from a simulation: the body, the forces on it, and what rays at it meet."""
