"""Reward terms: Table I of the paper and named options."""
