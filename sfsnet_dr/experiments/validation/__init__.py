"""SH shading against the path tracer: ``sfsnet-dr validate``."""
