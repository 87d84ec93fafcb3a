"""Terrains: tiles, the shared map, its heights, and the curriculum over it."""
