"""Speed: one file per ``sfsnet-dr bench`` command; ``agreement`` compares before ``common`` times."""
