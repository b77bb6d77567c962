"""The published protocols over whole data sets: every stage, every scene, one table."""
