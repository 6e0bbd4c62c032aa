"""Who collides with whom: a fixed set of pairs, by one bit a kind of thing."""

ROBOT, OBJECT, TABLE, FLOOR = 1, 2, 4, 8
"""MuJoCo `contype` of each kind."""
ROBOT_MEETS = ROBOT | OBJECT | TABLE
"""`conaffinity` of robot links; which links never meet each other is the description's to say."""
OBJECT_MEETS = ROBOT | OBJECT | TABLE | FLOOR
