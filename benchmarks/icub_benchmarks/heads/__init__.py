"""Benchmark of the on-line heads (``heads``), started by `run`.

- `parts`, `sweep`: what is measured; a new part is a function in `parts` and an entry of `run.PARTS`.
- `data`: synthetic features and sizes; `baselines`: scikit-learn and the FALKON library; `timing`: time and memory.
"""
