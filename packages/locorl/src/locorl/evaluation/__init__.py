"""Evaluating policies honestly."""
