"""What is in a URDF, and whether it can be scaled."""
