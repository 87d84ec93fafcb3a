"""What the results say: Gaussian processes of the objectives and of the probability that a design works."""
