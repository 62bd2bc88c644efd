"""Networks and baselines on faces with known normals: ``sfsnet-dr evaluate``."""
