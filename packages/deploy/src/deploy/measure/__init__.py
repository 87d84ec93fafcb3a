"""What a run achieved and what it cost."""
