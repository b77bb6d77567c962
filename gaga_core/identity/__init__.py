"""Identity of each Gaussian (section 3.3)."""
