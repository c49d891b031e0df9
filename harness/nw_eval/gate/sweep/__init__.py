"""How success changes along an axis of perturbation, and where it breaks off."""
