"""Pictures of a trial from outside the robot."""
