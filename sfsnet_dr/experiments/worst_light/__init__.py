"""Worst light."""
