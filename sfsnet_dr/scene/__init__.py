"""From a specification (``spec``) to a subject (mesh and camera) and a Mitsuba scene; ``faces`` and
``lights`` below.
"""
