"""Conformance kits for whoever writes an implementation of this package's interfaces (needs pytest)."""
