"""What a gradient costs by each method and what it is worth: on the paper's problems, over unknowns, over points."""
