"""Pages in a browser by viser: who may speak to them, and what they draw splats by."""
