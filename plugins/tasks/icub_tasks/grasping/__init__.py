"""The grasping task: a Markov decision process composed of a simulator, a robot and a grasp generator (thesis 12.3)."""
