"""The commands of ``sfsnet-dr``: each a dataclass of its arguments that calls the library.

Heavy imports stand inside ``run``, so that help and wrong arguments answer at once.
"""
