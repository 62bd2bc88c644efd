"""Errors of normals and images, and their intervals."""
