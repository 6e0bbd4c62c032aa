"""Benchmarks: measurements of this project and of its baselines, as ``icub benchmark NAME``.

- `heads`, `segmentation`, `grasps`: benchmarks of several modules, each started by its `run` (and by `incremental`,
  `superquadrics` and `vgn` beside it).
- One module per benchmark of the rest: `cli`, `environment`, `features`, `grasping`, `kinematics`, `main_job`,
  `simulation`; `compare` compares two results files.
- `results`: the command line and the results folder that all of them share.
- `parallel`: evaluation of a policy in several processes.

A new benchmark is a function ``main(argv: Sequence[str]) -> int | None`` in a module here, announced in pyproject.toml
under ``[project.entry-points."icub.benchmark"]``; other distributions announce theirs in the same group.
"""
