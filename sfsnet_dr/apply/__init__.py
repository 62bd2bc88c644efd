"""Decompose a photograph and relight it."""
