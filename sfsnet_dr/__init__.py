"""Physically based inverse rendering of faces: Mitsuba 3 ground truth, SH shading models, and SfSNet."""

__version__ = "0.1.0"
