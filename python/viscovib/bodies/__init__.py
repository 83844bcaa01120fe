"""A rigid body in space on its mounts."""
