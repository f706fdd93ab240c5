"""The memory of a batch: which arrays the kernels work on, and where in them a thing stands."""
