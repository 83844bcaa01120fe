"""The referee: random systems, loads and settings, checked by references that share no code."""
