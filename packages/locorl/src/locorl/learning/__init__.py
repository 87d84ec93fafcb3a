"""Training, fine-tuning and evaluating policies."""
