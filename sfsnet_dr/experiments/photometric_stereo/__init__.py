"""Normal labels from image sets: ``sfsnet-dr photometric-stereo``."""
