"""Path-traced references, ground-truth maps, light transport and the shading models."""
