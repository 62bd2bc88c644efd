"""The experiments behind the commands."""
