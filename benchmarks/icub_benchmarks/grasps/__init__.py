"""Benchmarks of grasp generators: grasps executed in several engines, and times and accuracy of the generators' parts.

- `run` (``grasps``): executes planned grasps in every engine (`engines`, by the script in `validate`) and runs the
  scripted policy.
- `superquadrics`: the superquadric fit beside other fits (`baselines`).
- `vgn`: times of the network's parts.

A benchmark of another grasp generator goes here as a module of its own.
"""
