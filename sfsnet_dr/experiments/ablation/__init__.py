"""Networks that differ in one setting: ``sfsnet-dr ablations``."""
