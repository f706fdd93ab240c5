"""The network: features, graph, messages, encoder, processor and decoder, and the correction of a rollout."""
