"""LeggedEnv: thousands of different bodies in one batched environment."""
