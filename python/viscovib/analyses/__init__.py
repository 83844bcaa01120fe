"""Analyses: steady responses, branches, motions in time, spectra, multiple scales."""
