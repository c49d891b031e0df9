"""From a scene to Gaussians: sampling, paint, light, leaves, sky."""
