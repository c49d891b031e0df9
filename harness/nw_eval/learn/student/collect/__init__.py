"""Driving trajectories: who drives, who looks on, where they run."""
