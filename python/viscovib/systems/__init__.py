"""What moves: mounts, pendulums, polynomial systems and structures, their laws and loads."""
