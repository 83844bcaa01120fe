"""Systems: mounts, pendulums, polynomial systems and structures, with their laws and loads."""
