"""Results of analyses."""
