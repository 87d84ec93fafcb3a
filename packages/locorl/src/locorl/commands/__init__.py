"""The subcommands of `locorl`."""
