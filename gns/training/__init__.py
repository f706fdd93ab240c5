"""Training: data, loss, unrolled rollouts, the state of a training, several processes."""
