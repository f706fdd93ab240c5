"""Column collapse beside the paper, other codes and experiments; what stiffness and step change."""
