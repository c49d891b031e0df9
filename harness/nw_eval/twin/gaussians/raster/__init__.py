"""Pictures of Gaussians, and gradients back to them."""
