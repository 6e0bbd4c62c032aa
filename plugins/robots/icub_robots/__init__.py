"""Robot descriptions and kinematics."""
