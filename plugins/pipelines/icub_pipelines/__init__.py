"""The stages of a run: teach, learn, see, plan, grasp, report."""
