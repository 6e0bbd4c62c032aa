"""Volumetric grasping: a truncated signed distance field in, a grasp for every voxel out; hand poses judged singly.

Proposing: `generator` calls `volume` and `range_view` (the field), `network`, `selection`, `adaptation` (to the hand),
`hand_search` and `judge` (single hand poses), `passage` (the way there).
Training: `training` calls `gripper_trials` and `hand_trials` (physics, with `trial_objects`; poses from `exploration`),
then `network_training` and `judge_training`, which share `descent` and `checkpoints`. `weights` is what ships, each
with its card.
"""
