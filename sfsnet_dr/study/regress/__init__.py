"""``sfsnet-dr regress``: do renderers show what they should, and how small a defect would be seen."""
