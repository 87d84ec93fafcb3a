"""Subcommands of `codesign`, a module each."""
