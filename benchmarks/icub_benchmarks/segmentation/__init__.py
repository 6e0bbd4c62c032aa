"""Benchmarks of segmenters: ``segmentation``, started by `run`, and ``incremental``.

- `methods`: what is compared; a new method is an entry of `methods.METHODS`.
- `trials`: tasks and kept trials; `trial`: one trial; `recording`: the main job's task as a pair of data sets.
- `voc`: average precision by the rules of PASCAL VOC; `trial_report`: tables and plots; `head_clock`: time in heads.
"""
