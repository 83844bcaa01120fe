"""Measured rubber: its data, and the kernels that fit them."""
