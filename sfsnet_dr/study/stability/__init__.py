"""``sfsnet-dr stability``: hard cases for every SH renderer and the reconstruction loss."""
