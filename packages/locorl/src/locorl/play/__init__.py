"""Watching a policy on a task."""
