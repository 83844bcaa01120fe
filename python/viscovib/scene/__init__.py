"""A scene file, read and run."""
