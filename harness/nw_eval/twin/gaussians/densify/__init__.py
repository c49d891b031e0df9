"""How Gaussians come and go."""
