"""Photometric stereo."""
