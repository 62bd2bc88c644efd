"""Lights: what one is (``light``), kinds and their samplers (``spec``, ``sampling``), named sets
(``presets``).
"""
