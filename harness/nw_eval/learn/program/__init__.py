"""What every training program shares: its config, its folder, its curve, what it says."""
