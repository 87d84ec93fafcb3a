"""Tasks: what the robots are asked to do, where, and when an episode ends."""
