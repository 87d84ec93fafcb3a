"""Runs on disk: MCAP with ROS 2 messages, written and read back."""
