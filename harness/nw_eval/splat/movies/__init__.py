"""Films and portraits of a splat."""
