"""What students learn from: trajectories on disk, and the samples made of them."""
