"""The whole pipeline on a small scale: ``sfsnet-dr demo``."""
