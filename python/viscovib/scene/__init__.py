"""Reading and running of scene files."""
