"""LeggedEnv for other libraries."""
