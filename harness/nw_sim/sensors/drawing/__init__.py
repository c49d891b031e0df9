"""Objects drawn into the images of a splat, and figures of what sensors see."""
