"""The hardest rung of a ladder that a policy still completes, with bounds: trials in, limit out."""
