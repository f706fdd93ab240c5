"""The memory of a batch: the arrays that the kernels work on, and the place of each quantity in them."""
