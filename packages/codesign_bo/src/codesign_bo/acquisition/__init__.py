"""Where to look next: acquisition functions, their maximisation, and the proposal of a trial."""
