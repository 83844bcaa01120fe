"""Relaxation kernels: what a material remembers."""
