"""The command line: one file a topic, ``commands`` lists all commands, ``main`` runs one, ``renamed``
knows old names.
"""
