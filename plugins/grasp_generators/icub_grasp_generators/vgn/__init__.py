"""The grasp generator `vgn` (Breyer et al. 2020), adapted to the iCub hand.

Proposing: `generator` calls `volume` and `range_view` (the field), `network`, `selection`, `adaptation` (to the hand),
`hand_search` with `exploration` and `judge` (single hand poses), `passage` (the way there).
Training: `training` calls `gripper_trials` and `hand_trials` (physics, with `trial_objects`), then `network_training` and
`judge_training`, which share `descent` and `checkpoints`. `weights` is what ships, each with its card.
"""
