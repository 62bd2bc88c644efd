"""Renderers against closed forms and stored references: ``sfsnet-dr regress``."""
