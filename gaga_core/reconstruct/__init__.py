"""From photos to Gaussians: structure from motion, training, density control."""
