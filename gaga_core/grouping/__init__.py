"""Association of masks across views by the 3D-aware memory bank (section 3.2)."""
