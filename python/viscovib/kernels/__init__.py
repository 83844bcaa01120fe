"""Relaxation kernels of materials with memory."""
