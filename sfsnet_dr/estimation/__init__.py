"""Methods by optimisation: photometric stereo, light calibration, 3DMM fits, SIRFS-like shading, light
priors.
"""
