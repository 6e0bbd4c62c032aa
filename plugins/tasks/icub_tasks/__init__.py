"""icub_tasks."""
