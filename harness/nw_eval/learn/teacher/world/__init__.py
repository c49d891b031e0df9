"""Many robots at once: their physics, their trails, what they see, what it is worth."""
