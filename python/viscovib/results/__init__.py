"""What analyses return."""
