"""What every part uses: checked parameters, files and tables, and what all results have."""
