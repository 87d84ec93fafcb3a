"""Running evaluations: dispatch, the loop that keeps an executor busy, and what is shown meanwhile."""
