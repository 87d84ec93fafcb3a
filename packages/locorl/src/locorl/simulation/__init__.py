"""Physics: scenes, the contract of a simulator, and its two implementations."""
