"""Common code: checked parameters, files, tables, and the base of all results."""
