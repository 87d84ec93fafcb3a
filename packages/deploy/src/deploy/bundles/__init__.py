"""The bundle on disk: its manifest, its hashes and its golden trace."""
