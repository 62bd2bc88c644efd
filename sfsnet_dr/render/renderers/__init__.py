"""Renderers behind one protocol (``base``), by name (``registry``): ours, Mitsuba's variants, Cycles,
other packages'.
"""
