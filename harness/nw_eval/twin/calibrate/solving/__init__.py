"""Features, matches, cameras and points: what COLMAP does, and how it is asked."""
