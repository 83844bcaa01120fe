"""Plots of systems and results."""
