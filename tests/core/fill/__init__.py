"""Tests of removal that leaves no hole."""
