"""The training: samples of datasets, losses, and the loop that lowers them."""
