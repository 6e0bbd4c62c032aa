"""Kinematics solvers behind the robot interface."""
