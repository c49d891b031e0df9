"""From photographs to a scene: what makes twins of real scenes. No package below imports it."""
