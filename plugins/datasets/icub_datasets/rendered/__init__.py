"""TARGET-TASKs that are rendered when asked for and kept on disk."""
