"""Unitree Go2 over DDS: what its low-level topics carry, and the robot that speaks them."""
