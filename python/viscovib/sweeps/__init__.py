"""Many runs of a scene or a function, with checkpoints."""
