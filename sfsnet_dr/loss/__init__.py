"""The paper's loss terms and the reconstruction loss in Dr.Jit and torch."""
