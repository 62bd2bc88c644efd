"""Edge cases through every SH renderer and the loss: ``sfsnet-dr stability``."""
