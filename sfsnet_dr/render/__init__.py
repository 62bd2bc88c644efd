"""Path tracing, AOVs, light transport, and the shading kernels in NumPy, torch and Dr.Jit."""
