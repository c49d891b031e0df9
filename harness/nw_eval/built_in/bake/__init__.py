"""From a place to Gaussians: sampling, paint, light, leaves, sky."""
