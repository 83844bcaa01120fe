"""What is computed: steady responses, branches, motions in time, spectra, multiple scales."""
