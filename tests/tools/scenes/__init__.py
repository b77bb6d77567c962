"""The program that drops scanned objects."""
