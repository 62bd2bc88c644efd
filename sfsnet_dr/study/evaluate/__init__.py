"""Measuring methods of inverse rendering on faces whose truth is known."""
