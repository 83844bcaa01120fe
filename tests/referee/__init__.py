"""A referee: random systems, loads and settings, every answer judged by something of no shared code."""
