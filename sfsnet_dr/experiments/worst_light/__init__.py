"""The light for which SH shading is most wrong: ``sfsnet-dr worst-light``."""
