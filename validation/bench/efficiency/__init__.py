"""Cost and quality of gradients by each method: on the paper's problems, over unknowns, over particles."""
