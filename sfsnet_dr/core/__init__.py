"""What every other folder needs: conventions, errors, TOML, image files, colour, versions and the choice
of LLVM.
"""
