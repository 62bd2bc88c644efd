"""Face databases: one reader per database behind ``registry``; ``base`` has what a photograph is."""
