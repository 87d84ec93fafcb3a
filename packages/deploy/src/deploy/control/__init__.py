"""The 50 Hz loop: states, guards, deadlines, joints bound by name."""
