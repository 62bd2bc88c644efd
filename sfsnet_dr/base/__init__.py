"""Conventions, checks, the choice of LLVM, colour, image files and provenance."""
