"""Measured rubber data and fitted kernels."""
