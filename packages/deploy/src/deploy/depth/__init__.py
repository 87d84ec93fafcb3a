"""Depth images: from a camera to what the network reads, the same for every camera."""
