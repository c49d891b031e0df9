"""From photographs with known cameras to depth maps: plane sweep and semi-global matching."""
