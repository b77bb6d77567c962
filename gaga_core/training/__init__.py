"""From cameras to Gaussians: training and density control (section 3.1)."""
