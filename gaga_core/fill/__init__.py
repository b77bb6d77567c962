"""Removal that leaves no hole: what an object hid is found, and its surface is continued."""
