"""The subcommands of ``icub``, one module each; heavy imports stay inside their functions."""
