"""The commands of `distill`, one module each."""
