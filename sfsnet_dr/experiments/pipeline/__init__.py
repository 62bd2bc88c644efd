"""All training stages: ``sfsnet-dr train-all``. ``run`` has the paper's set, ``release`` one released
network.
"""
