"""Looking at a run folder from outside, while its run goes on or afterwards; nothing in it is ever written."""
