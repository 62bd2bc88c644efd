"""Data sets: one rendered face (``bundle``), a folder of them (``dataset``), rendering them (``generate``),
photographs and labels. ``transforms`` has operations on images, ``databases`` one reader per database.
"""
