"""Real spherical harmonics: basis, coefficients, rotation, projection and light priors."""
