"""Networks, their weights files and the weights in the package; ``inference`` loads and runs them."""
