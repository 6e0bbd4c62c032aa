"""Subcommands of ``icub`` beside `run`: plugins, train, completion; the heavy imports stay inside their functions."""
