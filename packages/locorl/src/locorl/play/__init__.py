"""Watching a policy on a task, live in the browser or as a video."""
