<<<<<<< HEAD
"""Subcommands of `codesign`, a module each."""
=======
"""The subcommands of `codesign`, one module each."""
>>>>>>> c6e71f2 (codesign compare: finished runs side by side)
